"""Motors that act late: u(t − T)."""

from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.command import Command
from invdyn.models.effects.parameter import Parameter, Values, quantiles
from invdyn.models.effects.scale import Scale


class ActuatorDelay(Actuator):
    """A dead time T between a command and its torque; before the first row's command it was what it is there.

    With all joints alike, cannot be told from a late camera without a common clock.
    """

    phrase = "actuator delay"
    meaning = "torques that come later than commanded"
    shown_by = "a common clock of camera and motors, such as a light that the command switches"
    of_targets = True
    twins: ClassVar[Mapping[str, Mapping[str, str]]] = {"camera_latency": {"delay": "latency"}}

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Dead time T, s."""
        prior = HalfNormal(self.delay_scale(scale))
        return (Parameter("delay", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """u(t − T)."""
        return command.delayed(self.at_joints(p["delay"], command.mean.shape[-1]))

    def late(self, p: Values, elapsed: Tensor, joints: int) -> Tensor:
        """All of it, until T has passed."""
        return (elapsed < self.at_joints(p["delay"], joints)).to(elapsed)
