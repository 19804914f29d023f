"""Where a simulation leaves what numbers can hold: the one error of it, so that no other is taken for it.

A search tries parameters with which no simulation runs: its path is not finite, or a covariance that follows from it
has no factor. Both are answers, "not with these", and a search catches them by type. A wrong shape, a name that does
not exist, or any other slip in a model is none, and passes.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


class Diverged(ArithmeticError):
    """The simulation, or what is linearised about it, is not finite."""


class Singular(Diverged):
    """A matrix that had to be factorised or inverted is singular, or no covariance."""


def ran_away(row: int) -> str:
    """What to say of a simulation whose state is no number from a row on, rather than blame what was observed there."""
    return (
        f"the simulation ran away: its state is no number at row {row}; more sub-steps, smaller torques, or a joint "
        "whose motion stays away from the poles of its angles (a pitch of 90°) keep it finite"
    )


def check_finite(path: torch.Tensor) -> None:
    """Raise :class:`Diverged` with the first row at which a path (…, T, D) is no number."""
    diverged = ~torch.isfinite(path).all(-1).reshape(-1, path.shape[-2]).all(0)
    if bool(diverged.any()):
        raise Diverged(ran_away(int(diverged.int().argmax())))


@contextmanager
def diverging() -> Iterator[None]:
    """Raise :class:`Singular` for what NumPy and torch say of a matrix without factors.

    NumPy's error of a matrix that is not square, or no matrix, is of the same class; it is a bug, and is left as it is.
    """
    try:
        yield
    except torch.linalg.LinAlgError as error:
        raise Singular(str(error)) from error
    except np.linalg.LinAlgError as error:
        if "dimension" in str(error):
            raise
        raise Singular(str(error)) from error
