"""Methods that have new names: the old ones work for one version, with a warning. The command line reads it, too."""

import warnings

RENAMED = {"nested": "smc"}


def present_name(method: str) -> str:
    """The method's name; of one that was renamed the new one, and for one version a warning says so."""
    if method not in RENAMED:
        return method
    new = RENAMED[method]
    warnings.warn(f"the method {method!r} is now {new!r}; the old name works in this version alone", stacklevel=3)
    return new
