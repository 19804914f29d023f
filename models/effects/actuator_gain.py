"""Motors that give more or less than they are told: (1 + ε) u, and servos that pull harder or less hard.

A servo makes K c + u₀ − S θ − D θ̇ of its target c (:mod:`..bodies.joint_parts`). Its gain is the factor on what it
makes of the target and of the quantity that this is for,

    τ = (1 + ε)(K c + u₀ − S θ) − D θ̇        of one that is told angles, kp in MuJoCo
    τ = (1 + ε)(K c + u₀ − D θ̇) − S θ        of one that is told velocities, kv in MuJoCo
"""

from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal, StudentT
from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.command import Command
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.servo_answer import OfServos, answer_changed

LEAST = -0.8
"""Motors that give nearly nothing, of arms without mass, explain whatever there is."""


GEARS = 15.0
"""ε that a gear which was left out is of the order of; robots' gears turn from a few to a hundred and sixty times."""
LEFT_OUT = 1.0
"""Its least."""


class ActuatorGain(Actuator, OfServos):
    """Torque (1 + ε) u, of a wrong torque constant or gear ratio; of a servo a gain that is not its file's.

    ``ActuatorGain("elbow", "geared")`` is a torque that was logged before its gear. For all joints neither can be told
    from a common factor of all masses, unless there is a known weight or a passive recording. As ``gear`` in MuJoCo.
    """

    phrase = "an actuator gain"
    meaning = "torques larger or smaller than commanded, by one factor; of a servo its gain"
    shown_by = "a known weight at the tip, or a passive swing"
    form_words: ClassVar[Mapping[str, str]] = {
        "geared": "as of a torque that was logged before its gear",
    }

    order = -1
    forms: ClassVar[tuple[str, ...]] = ("geared",)

    @property
    def of_targets(self) -> bool:  # type: ignore[override]  # a target has no gear that may be left out
        """Whether it may be a servo's."""
        return not self.form

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Excess ε, a pure number; some gears are not what was written down, or not thought of at all."""
        if self.form:
            return (Parameter("gain", "1", HalfNormal(GEARS), least=LEFT_OUT),)
        return (Parameter("gain", "1", StudentT(3.0, 0.0, 0.15), least=LEAST),)

    def command(self, p: Values, command: Command) -> Command:
        """(1 + ε) u."""
        factor = 1 + self.at_joints(p["gain"], command.mean.shape[-1])
        return command.changed(lambda torque: factor * torque)

    def force(self, p: Values, now: Situation) -> Tensor | None:
        """−ε S θ, or −ε D θ̇ where velocities are told, within a servo's limits; the command has the rest."""
        found = [now.at(k, self._answer(p["gain"], k, servo, now)) for k, servo in self.servos.items()]
        return sum(found[1:], start=found[0]) if found else None

    def _answer(self, gain: Tensor, k: int, servo: Motor, now: Situation) -> Tensor:
        stiff, slow = servo.stiffness * now.q[..., k : k + 1], servo.damping * now.qd[..., k : k + 1]
        more = -gain * (stiff if servo.kind == "position" else slow)
        return answer_changed(servo, k, now, more)
