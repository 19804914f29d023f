"""Motors that give more or less than they are told: (1 + ε) u."""

from pyro.distributions import StudentT

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.command import Command
from invdyn.models.effects.scale import Scale

LEAST = -0.8
"""Motors that give nearly nothing, of arms without mass, explain whatever there is."""


class ActuatorGain(Actuator):
    """Torque (1 + ε) u, of a wrong torque constant or gear ratio.

    For all joints it cannot be told from a common factor of all masses, unless there is a known weight or a passive
    recording. As ``gear`` in MuJoCo.
    """

    phrase = "an actuator gain"
    meaning = "torques larger or smaller than commanded, by one factor"
    shown_by = "a known weight at the tip, or a passive swing"

    order = -1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Excess ε, a pure number; some gears are not what was written down."""
        return (Parameter("gain", "1", StudentT(3.0, 0.0, 0.15), least=LEAST),)

    def command(self, p: Values, command: Command) -> Command:
        """(1 + ε) u."""
        factor = 1 + self.at_joints(p["gain"], command.mean.shape[-1])
        return command.changed(lambda torque: factor * torque)
