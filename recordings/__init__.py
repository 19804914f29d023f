"""Keypoint tracks in, results out: formats, units, named real recordings."""

import lazy_loader

# The names stand in __init__.pyi, where editors and type checkers look too; a file is imported once one is asked for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
