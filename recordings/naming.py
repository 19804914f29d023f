"""Which name a misspelt one stands for: letters first, case, spaces, hyphens and underscores last."""

import difflib
from collections.abc import Iterable


def alike(name: str, known: Iterable[str]) -> str | None:
    """The first of `known` that differs from `name` in case, spaces, hyphens and underscores alone, if there is one."""
    return next((other for other in known if other != name and _letters(other) == _letters(name)), None)


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The one of `known` that `name` most probably stands for; None if nothing is known."""
    known = list(known)
    return alike(name, known) or next(iter(difflib.get_close_matches(name, known, 1, cutoff=0.0)), None)


def _letters(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter not in " _-\t")
