"""Bodies, their parameters, and the files that describe them."""
