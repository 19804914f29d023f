"""File formats: one reader each, and the registry that recognises them."""
