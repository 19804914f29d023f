"""A motor at its limit: u clipped to ±u_max."""

import math

import torch
from pyro.distributions import LogNormal

from invdyn.models.effects.base import Effect, Parameter, Values, with_entry
from invdyn.models.effects.command import Command
from invdyn.models.effects.scale import Scale

QUANTILES = (0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97)


class ActuatorSaturation(Effect):
    """Torque clip(u, ±u_max) at a joint; absent at an infinite u_max.

    Told apart from a gain by commands of several amplitudes. As ``forcerange`` in MuJoCo.
    """

    phrase = "actuator saturation"
    meaning = "torques that stop growing at a limit"
    shown_by = "a ladder of amplitudes"

    needs_command, order = True, -2

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Largest torque u_max, N·m; the grid follows the command's own sizes."""
        j = self.place[0]
        sizes = torch.linspace(0, 1, 101) * scale.effort[j] if scale.command is None else scale.command[:, j].abs()
        grid = torch.quantile(sizes, torch.tensor(QUANTILES).to(sizes)).clamp_min(0.02 * scale.effort[j])
        prior = LogNormal(math.log(0.6 * scale.effort[j]), 0.4)
        return (Parameter("limit", "N·m", prior, math.inf, tuple(grid.tolist())),)

    def command(self, p: Values, command: Command) -> Command:
        """clip(u, ±u_max)."""
        j, limit = self.place[0], p["limit"]
        return command.changed(
            lambda torque: with_entry(torque, j, torch.maximum(torch.minimum(torque[..., j : j + 1], limit), -limit))
        )
