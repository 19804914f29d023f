"""Dynamics of bodies in space: algorithms traced once for each body."""
