"""A parameter of an effect: name, unit, prior, and the value at which the effect is absent."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from pyro.distributions import Distribution
from torch import Tensor

Values = Mapping[str, Tensor]
"""An effect's own parameters by their own names, (..., 1) each."""


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    Attributes:
        name: a plain word.
        unit: such as "N·m·s/rad"; "1" for a pure number.
        prior: scalar Pyro distribution; its spread follows from the body's scales.
        absent: value at which the effect vanishes, whatever the others are; None for a parameter that has none, such
            as a frequency.
        grid: values at which a screen evaluates a parameter that the effect does not follow in a straight line from
            ``absent`` on, spread as the prior is.
        least: no smaller value is plausible, whatever tail the prior has on the other side.

    A parameter without ``absent`` and ``grid`` is one of the effect's :attr:`Effect.located`.
    """

    name: str
    unit: str
    prior: Distribution
    absent: float | None = 0.0
    grid: tuple[float, ...] = ()
    least: float = -math.inf


def quantiles(prior: Distribution, count: int) -> tuple[float, ...]:
    """Values as a prior spreads them: the middles of ``count`` parts of equal probability."""
    return tuple(prior.icdf((torch.arange(count) + 0.5) / count).tolist())
