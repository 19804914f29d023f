"""An encoder that counts from elsewhere than the simulation's joint: it shows θ + δ.

A servo follows its encoder. So one that holds a target holds another angle, off by δ:

    τ = K c + u₀ − S (θ + δ) − D θ̇
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Self

from pyro.distributions import StudentT
from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Values, with_entry
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.servo_answer import answer_changed, servos_at
from invdyn.models.observation.view import View


class EncoderOffset(Effect):
    """A joint's encoder shows its angle and δ more, all along.

    Gravity tells it, and the weight of the links beyond the joint. Of a chain in the plane the first joint's cannot be
    told from tilted gravity without a camera. About an axis along gravity nothing shows the first joint's.
    """

    phrase = "an encoder offset"
    meaning = "an encoder whose zero is not the simulation's"
    shown_by = "encoders and a camera together, or the base's own edges in view of the camera"

    side, sensor, order = "observation", "encoders", 1
    servos: Mapping[int, Motor] = MappingProxyType({})
    """The servo of its joint, by number; empty without one."""

    @property
    def drives(self) -> bool:  # type: ignore[override]  # where a servo follows the encoder
        """Whether a servo follows it."""
        return bool(self.servos)

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        other.servos = servos_at(body, other.place)
        return other

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offset δ, rad, of a slide m: nine encoders in ten are within 3°; any may be off by more."""
        return (Parameter("offset", "rad", StudentT(3.0, 0.0, 0.02)),)

    def force(self, p: Values, now: Situation) -> Tensor | None:
        """−S δ of a servo, within its limits."""
        for k, servo in self.servos.items():
            return now.at(k, answer_changed(servo, k, now, -servo.stiffness * p["offset"]))
        return None

    def angles(self, p: Values, view: View) -> Tensor:
        """θ + δ."""
        k = self.place[0]
        return with_entry(view.angles, k, view.angles[..., k : k + 1] + p["offset"])
