"""Keypoint tracks in, results out: formats, units, named real recordings."""

import lazy_loader

# The names are in __init__.pyi, for editors and type checkers too; a file is imported when one of its names is used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
