"""Frames taken at another rate than stated."""

from pyro.distributions import LogNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale


class ClockRate(Effect):
    """The frame clock runs at s times the stated rate: true time = stated time / s.

    Commands keep to the rows that they were recorded in. Passive, it cannot be told from another strength of gravity.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Rate s, a pure number."""
        return (Parameter("rate", "1", LogNormal(0.0, 0.15), 1.0),)

    def interval(self, p: Values, dt: Tensor) -> Tensor:
        """δ / s."""
        return dt / p["rate"]
