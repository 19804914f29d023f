"""Parameters that add to what the simulation's own file has: a change, which may take away as much as is there."""

import math
from collections.abc import Sequence

from pyro.distributions import HalfNormal, Normal

from invdyn.models.effects.base import Parameter

GUESSED = 0.5
"""Of what a file says of friction or a rotor, by which it may well be off: such numbers are guessed more often than
measured."""


def change(name: str, unit: str, spread: float, filed: float, shares: Sequence[float] = ()) -> Parameter:
    """A parameter of 0 or more, half-normal of ``spread``; of a joint whose file has some, a change of it.

    ``shares`` of the spread are where a screen looks, if the effect follows it in no straight line.
    """
    if filed <= 0:
        return Parameter(name, unit, HalfNormal(spread), 0.0, tuple(spread * x for x in shares))
    wide = math.hypot(spread, GUESSED * filed)
    lower = [-x * filed for x in (0.9, 0.5)] if shares else []
    return Parameter(name, unit, Normal(0.0, wide), 0.0, (*lower, *(wide * x for x in shares)), least=-filed)
