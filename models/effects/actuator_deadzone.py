"""A motor that small commands do not move: u − clip(u, ±d)."""

import torch
from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values, with_entry
from invdyn.models.effects.command import Command
from invdyn.models.effects.scale import Scale


class ActuatorDeadzone(Effect):
    """Torque 0 for commands within ±d, and smaller by d beyond.

    Told apart from a gain by small commands.
    """

    phrase = "an actuator dead zone"
    meaning = "commands too small to turn into torque"
    shown_by = "small commands"

    needs_command, order = True, -4

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Half-width d, N·m."""
        return (Parameter("width", "N·m", HalfNormal(0.06 * scale.effort[self.place[0]])),)

    def command(self, p: Values, command: Command) -> Command:
        """U − clip(u, ±d)."""
        j, width = self.place[0], p["width"]

        def shrunk(torque: Tensor) -> Tensor:
            own = torque[..., j : j + 1]
            return with_entry(torque, j, own - torch.maximum(torch.minimum(own, width), -width))

        return command.changed(shrunk)
