"""Where simulation and recording part, why, and by how much less once the cause is added (not yet built)."""
