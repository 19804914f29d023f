"""Where simulation and recording part, why, and by how much less once the cause is added."""

import lazy_loader

# The names stand in __init__.pyi, where editors and type checkers look too; files are imported at first use.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
