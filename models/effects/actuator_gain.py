"""Motors whose torque is off by a factor: (1 + ε) u, and servos whose gain is.

A servo makes K c + u₀ − S θ − D θ̇ of its target c (:mod:`..bodies.joint_parts`). Its gain is the factor on what it
makes of the target and of the quantity that this is for,

    τ = (1 + ε)(K c + u₀ − S θ) − D θ̇        if its targets are angles, kp in MuJoCo
    τ = (1 + ε)(K c + u₀ − D θ̇) − S θ        if its targets are velocities, kv in MuJoCo
"""

from typing import ClassVar

from pyro.distributions import HalfNormal, StudentT
from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.effects.actuator import Actuator
from invdyn.models.effects.base import Command, Parameter, Scale, Situation, Values
from invdyn.models.effects.servo_answer import OfServos, answer_changed

LEAST = -0.8
"""Least ε of a motor: arms without mass under motors that give nearly nothing would explain any recording."""
LEAST_OF_SERVO = -0.999
"""Of a servo, which falls behind its target by what it carries: public files of one arm have gains 56 apart."""
GEARS = 15.0
"""Order of ε for a gear that was left out; robots' gears have ratios from a few to a hundred and sixty."""
LEFT_OUT = 1.0
"""Least ε of such a gear."""


class ActuatorGain(Actuator, OfServos):
    """Torque (1 + ε) u, of a wrong torque constant or gear ratio; of a servo a gain that is not its file's.

    ``ActuatorGain("elbow", "geared")`` is a torque that was logged before its gear. For all joints only a known weight
    or a passive recording distinguishes either from a common factor of all masses. As ``gear`` in MuJoCo.
    """

    order = -1
    forms: ClassVar[tuple[str, ...]] = ("geared",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Excess ε, a pure number; some gears are not what was written down, or were left out."""
        if self.form:
            return (Parameter("gain", "1", HalfNormal(GEARS), least=LEFT_OUT),)
        servos = all(k in self.servos for k in self.place) and bool(self.place)
        return (Parameter("gain", "1", StudentT(3.0, 0.0, 0.15), least=LEAST_OF_SERVO if servos else LEAST),)

    def command(self, p: Values, command: Command) -> Command:
        """(1 + ε) u."""
        factor = 1 + self.at_joints(p["gain"], command.mean.shape[-1])
        return command.changed(lambda torque: factor * torque)

    def answer(self, p: Values, now: Situation) -> Tensor | None:
        """−ε S θ, or −ε D θ̇ for targets of velocity, within a servo's limits; the command has the rest."""
        found = [now.at(k, self._more(p["gain"], k, servo, now)) for k, servo in self.servos.items()]
        return sum(found[1:], start=found[0]) if found else None

    def _more(self, gain: Tensor, k: int, servo: Motor, now: Situation) -> Tensor:
        stiff, slow = servo.stiffness * now.q[..., k : k + 1], servo.damping * now.qd[..., k : k + 1]
        return answer_changed(servo, k, now, -gain * (stiff if servo.kind == "position" else slow))
