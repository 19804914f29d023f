"""Motors that act late: u(t − T)."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Command, Parameter, Scale, Values, quantiles


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
