"""Dynamics of bodies in space: algorithms written scalar by scalar, traced once for each body, run by torch or numba."""
