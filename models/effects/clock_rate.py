"""Frames taken at another rate than stated: their true times are t₀ + (t − t₀)/s."""

from typing import ClassVar

from pyro.distributions import LogNormal
from torch import Tensor

from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, quantiles


class ClockRate(Effect):
    """The frame clock runs at s times the stated rate: true time = stated time / s.

    One clock stamps all rows; commands stay in the rows in which they were recorded. In a passive recording only a
    known strength of gravity shows it. ``ClockRate("frames")`` are sensors with a clock of their own, while commands
    keep true time; both agree at the first row.
    """

    side, site, sensor, order = "observation", "arm", "any", 1
    forms: ClassVar[tuple[str, ...]] = ("frames",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Rate s, a pure number."""
        prior = LogNormal(0.0, 0.15)
        # By the end of a recording even a little of it is late by as much as commands take to change.
        return (Parameter("rate", "1", prior, 1.0, quantiles(prior, 24) if self.form else ()),)

    def command(self, p: Values, command: Command) -> Command:
        """The command at the true time, t_0 + (t − t_0) / s."""
        return command.paced(p["rate"]) if self.form else command

    def interval(self, p: Values, dt: Tensor) -> Tensor:
        """δ / s."""
        return dt / p["rate"]
