"""A parameter of an effect: name, unit, prior, and the value at which the effect is absent."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from pyro.distributions import Distribution, HalfNormal, Normal
from torch import Tensor

Values = Mapping[str, Tensor]
"""An effect's own parameters by their own names, (..., 1) each."""

GUESSED = 0.5
"""Relative error, a standard deviation, of friction or a rotor that a file states: more are guessed than measured."""


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    Attributes:
        name: a plain word.
        unit: such as "N·m·s/rad"; "1" for a pure number.
        prior: scalar Pyro distribution; its width follows from the body's scales.
        absent: value at which the effect vanishes, for any values of the others; None for a parameter that has none,
            such as a frequency.
        grid: values at which a screen evaluates a parameter in which the effect is not linear from ``absent`` on,
            distributed as the prior is.
        least: no smaller value is plausible, though the prior has a tail there.
    """

    name: str
    unit: str
    prior: Distribution
    absent: float | None = 0.0
    grid: tuple[float, ...] = ()
    least: float = -math.inf

    @property
    def located(self) -> bool:
        """Whether the recording itself suggests its values: of an effect that acts for a while its ``moment``, the
        middle, and its ``duration``, s.
        """
        return self.absent is None and not self.grid


def quantiles(prior: Distribution, count: int) -> tuple[float, ...]:
    """Middles of ``count`` intervals of equal prior probability."""
    return tuple(prior.icdf((torch.arange(count) + 0.5) / count).tolist())


def change(name: str, unit: str, sd: float, filed: float, shares: Sequence[float] = ()) -> Parameter:
    """A parameter of 0 or more, half-normal of ``sd``; where the simulation's file has ``filed`` of it, a change.

    ``shares`` of the prior's width are where a screen looks, if the effect is not linear in it.
    """
    if filed <= 0:
        return Parameter(name, unit, HalfNormal(sd), 0.0, tuple(sd * x for x in shares))
    wide = math.hypot(sd, GUESSED * filed)
    lower = [-x * filed for x in (0.9, 0.5)] if shares else []
    return Parameter(name, unit, Normal(0.0, wide), 0.0, (*lower, *(wide * x for x in shares)), least=-filed)
