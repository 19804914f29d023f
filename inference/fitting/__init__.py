"""Parameters by marginal likelihood, and which of them the data identify."""
