"""A refinement that may fail: where it does, there is no cause."""

from collections.abc import Callable
from typing import Any, TypeVar

from invdyn.diagnosis.budget import Spent
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.composition import NotTogether

T = TypeVar("T")


def attempt(work: Callable[..., T], *arguments: Any, **options: Any) -> T | None:
    """Such as a refinement; None where it ends at parameters with which the simulation does not run at all, to
    effects that no simulation has together, or where the budget is spent.
    """
    try:
        with diverging():
            return work(*arguments, **options)
    except (Diverged, NotTogether, Spent):
        return None
