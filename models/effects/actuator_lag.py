"""Motors that follow their command slowly: T u̇_f + u_f = u."""

import torch
from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Command, Parameter, Scale, Values, quantiles


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
