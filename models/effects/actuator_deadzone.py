"""A motor that small commands do not move: u − clip(u, ±d)."""

import torch
from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, with_entry


class ActuatorDeadzone(Effect):
    """Torque 0 for commands within ±d, and smaller by d beyond.

    Small commands distinguish it from a gain.
    """

    order = -4

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Half-width d, N·m."""
        return (Parameter("width", "N·m", HalfNormal(0.06 * scale.effort[self.place[0]])),)

    def command(self, p: Values, command: Command) -> Command:
        """U − clip(u, ±d)."""

        def shrunk(torque: Tensor) -> Tensor:
            u, d = self.own(torque), p["width"]
            return with_entry(torque, self.place[0], u - torch.maximum(torch.minimum(u, d), -d))

        return command.changed(shrunk)
