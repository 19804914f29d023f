"""Names: suggestions for misspelt ones, and one animal of several. Case, spaces and hyphens count least."""

import difflib
from collections.abc import Iterable

from .errors import InputError


def same_letters(name: str, known: Iterable[str]) -> str | None:
    """The first of `known` that differs from `name` in case, spaces, hyphens and underscores alone, if there is one."""
    return next((other for other in known if other != name and _letters(other) == _letters(name)), None)


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The one of `known` that `name` probably means; None if it is similar to none."""
    known = list(known)
    return same_letters(name, known) or next(iter(difflib.get_close_matches(name, known, 1)), None)


def closest(name: str, known: Iterable[str]) -> str:
    """Words for a message that has `name`: " (closest: 'wrist')", or nothing where none is similar."""
    near = nearest(name, known)
    return "" if near is None else f" (closest: {near!r})"


def _letters(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter not in " _-\t")


def choose_individual(names: list[str], individual: str | None) -> str:
    """The only name, or the chosen one; InputError when there are several, or the chosen one is not there."""
    if individual in names:
        return individual
    if individual is not None or len(names) != 1:
        problem = "several individuals" if individual is None else f"no individual {individual!r}"
        raise InputError(f"{problem}: choose one of {', '.join(names)} (--set individual=NAME)")
    return names[0]
