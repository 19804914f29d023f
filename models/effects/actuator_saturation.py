"""A motor at its limit: u clipped to ±u_max."""

import math

import torch
from pyro.distributions import LogNormal
from torch import Tensor

from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, with_entry

QUANTILES = (0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97)


class ActuatorSaturation(Effect):
    """Torque clip(u, ±u_max) at a joint; absent at an infinite u_max. As ``forcerange`` in MuJoCo.

    Commands of several amplitudes distinguish it from a gain.
    """

    order = -2

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Largest torque u_max, N·m; the grid follows the command's own sizes."""
        j = self.place[0]
        sizes = torch.linspace(0, 1, 101) * scale.effort[j] if scale.command is None else scale.command[:, j].abs()
        grid = torch.quantile(sizes, torch.tensor(QUANTILES).to(sizes)).clamp_min(0.02 * scale.effort[j])
        prior = LogNormal(math.log(0.6 * scale.effort[j]), 0.4)
        return (Parameter("limit", "N·m", prior, math.inf, tuple(grid.tolist())),)

    def command(self, p: Values, command: Command) -> Command:
        """clip(u, ±u_max)."""

        def clipped(torque: Tensor) -> Tensor:
            limit = p["limit"]
            return with_entry(torque, self.place[0], torch.maximum(torch.minimum(self.own(torque), limit), -limit))

        return command.changed(clipped)
