"""Names: suggestions for misspelt ones, one animal of several, one side of a body.

Case, spaces, dots and hyphens count least.
"""

import difflib
import re
from collections.abc import Collection, Iterable, Sequence

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


def of_one_side(wanted: Sequence[str], known: Sequence[str], base: str) -> dict[str, str]:
    """By name in a file, what a body calls it: "R.Elbow" is an elbow where the base is "R.Shoulder".

    What stands before or after the body's name must stand there in the ``base``, too. Empty unless that gives one
    keypoint for each of the names that are ``wanted``.
    """
    parts = [(name, other, *_letters(other).partition(_letters(name))) for name in wanted for other in known]
    sides = {(before, after) for _, _, before, word, after in parts if word}
    own = {side for side in sides if _is_of(base, side, sides - {side}, known)}
    found: dict[str, list[str]] = {}
    for name, other, before, word, after in parts:
        if word and (before, after) in own:
            found.setdefault(name, []).append(other)
    alone = {others[0]: name for name, others in found.items() if len(others) == 1}
    return alone if len(alone) == len(wanted) else {}


def _is_of(base: str, side: tuple[str, str], others: Collection[tuple[str, str]], known: Sequence[str]) -> bool:
    """Whether a base is of a side, by a word of its own, "R.Hip", or beside one of another, "rhip" and "lhip"."""
    (before, after), first = side, _letters(base)
    rest = first.removeprefix(before).removesuffix(after)
    if not before + after or first != before + rest + after:
        return False
    words = [word.casefold() for word in re.split(r"[ ._\t-]+|(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", base)]
    beside = {one + rest + end for one, end in others} & {_letters(name) for name in known}
    return bool(beside) or (len(words) > 1 and before in ("", words[0]) and after in ("", words[-1]))


def some(names: Sequence[str]) -> str:
    """The names for a message, the first twelve of many."""
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _letters(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter not in " ._-\t")


def choose_individual(names: list[str], individual: str | None) -> str:
    """The only name, or the chosen one; InputError when there are several, or the chosen one is not there."""
    if individual in names:
        return individual
    if individual is not None or len(names) != 1:
        problem = "several individuals" if individual is None else f"no individual {individual!r}"
        raise InputError(f"{problem}: choose one of {', '.join(names)} (--set individual=NAME)")
    return names[0]
