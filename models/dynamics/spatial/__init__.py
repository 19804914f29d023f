"""Dynamics of bodies in space: algorithms traced once for each body, run by torch or as machine code."""
