"""What sensors show of the state, and how missing entries drop out."""
