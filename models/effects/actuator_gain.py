"""Motors that give more or less than they are told: (1 + ε) u."""

from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal, StudentT

from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.command import Command
from invdyn.models.effects.scale import Scale

LEAST = -0.8
"""Motors that give nearly nothing, of arms without mass, explain whatever there is."""


GEARS = 15.0
"""ε that a gear which was left out is of the order of; robots' gears turn from a few to a hundred and sixty times."""
LEFT_OUT = 1.0
"""Its least."""


class ActuatorGain(Actuator):
    """Torque (1 + ε) u, of a wrong torque constant or gear ratio.

    ``ActuatorGain("elbow", "geared")`` is a torque that was logged before its gear. For all joints neither can be told
    from a common factor of all masses, unless there is a known weight or a passive recording. As ``gear`` in MuJoCo.
    """

    phrase = "an actuator gain"
    meaning = "torques larger or smaller than commanded, by one factor"
    shown_by = "a known weight at the tip, or a passive swing"
    form_words: ClassVar[Mapping[str, str]] = {
        "geared": "as of a torque that was logged before its gear",
    }

    order = -1
    forms: ClassVar[tuple[str, ...]] = ("geared",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Excess ε, a pure number; some gears are not what was written down, or not thought of at all."""
        if self.form:
            return (Parameter("gain", "1", HalfNormal(GEARS), least=LEFT_OUT),)
        return (Parameter("gain", "1", StudentT(3.0, 0.0, 0.15), least=LEAST),)

    def command(self, p: Values, command: Command) -> Command:
        """(1 + ε) u."""
        factor = 1 + self.at_joints(p["gain"], command.mean.shape[-1])
        return command.changed(lambda torque: factor * torque)
