"""What is said of the causes that were found: how probable, where, how large, and how far the gap closes."""
