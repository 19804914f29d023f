"""Malformed inputs of every kind that users and attackers have met, over all commands of the command line."""

from itertools import chain

from . import bodies, calibrations, options, paths, recordings, stores
from .case import Case, make_good

PARTS = (recordings, bodies, options, paths, stores, calibrations)

__all__ = ["Case", "all_cases", "make_good"]


def all_cases() -> list[Case]:
    """All of them, each once."""
    return list(chain.from_iterable(part.cases() for part in PARTS))
