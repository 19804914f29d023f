"""The choice of one animal or person in files of several."""

from ..errors import InputError


def choose_individual(names: list[str], individual: str | None) -> str:
    """The only name, or the chosen one; InputError when there are several, or the chosen one is not there."""
    if individual in names:
        return individual
    if individual is not None or len(names) != 1:
        problem = "several animals" if individual is None else f"no animal {individual!r}"
        raise InputError(f"{problem}: choose one of {', '.join(names)} (--set individual=NAME)")
    return names[0]
