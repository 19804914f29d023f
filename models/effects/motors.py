"""What motors make of a command: one effect a class.

actuator_deadzone    a motor that small commands do not move: u − clip(u, ±d)
actuator_delay       motors that act late: u(t − T)
actuator_lag         motors that follow their command slowly: T u̇_f + u_f = u
actuator_saturation  a motor at its limit: u clipped to ±u_max
"""

import math

import torch
from pyro.distributions import HalfNormal, LogNormal
from torch import Tensor

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, quantiles, with_entry


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


class ActuatorDelay(Actuator):
    """A dead time T between a command and its torque; before the first row the command is the first row's.

    With all joints equal, only a common clock distinguishes it from a late camera.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Dead time T, s."""
        prior = HalfNormal(self.delay_scale(scale))
        return (Parameter("delay", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """u(t − T)."""
        return command.delayed(self.at_joints(p["delay"], command.mean.shape[-1]))

    def late(self, p: Values, elapsed: Tensor) -> Tensor:
        """All of it, until T has passed."""
        return (elapsed < self.at_joints(p["delay"], elapsed.shape[-1])).to(elapsed)


class ActuatorLag(Actuator):
    """A first-order lag between a command and its torque. ``dyntype="filter"`` in MuJoCo.

    Commands above the angular frequency 1/T distinguish it from a delay.
    """

    order = -3

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Time constant T, s."""
        prior = HalfNormal(self.delay_scale(scale))
        return (Parameter("time_constant", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """The lagging torque, at rest with the first command."""
        return command.lagged(self.at_joints(p["time_constant"], command.mean.shape[-1]))

    def late(self, p: Values, elapsed: Tensor) -> Tensor:
        """exp(−t/T)."""
        T = self.at_joints(p["time_constant"], elapsed.shape[-1])
        return torch.exp(-elapsed / T.clamp_min(1e-12)) * (T > 0)


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
