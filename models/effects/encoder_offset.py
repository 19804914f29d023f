"""An encoder whose zero is not the simulation's: it shows θ + δ.

A servo follows its encoder. So one that holds a target holds another angle, off by δ:

    τ = K c + u₀ − S (θ + δ) − D θ̇
"""

from pyro.distributions import StudentT
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Situation, Values, View, with_entry
from invdyn.models.effects.servo_answer import OfServos, answer_changed


class EncoderOffset(OfServos):
    """A joint's encoder shows its angle and a constant δ more.

    Gravity shows it, by the weight of the links beyond the joint. Of a chain in the plane only a camera distinguishes
    the first joint's from tilted gravity. About an axis along gravity nothing shows the first joint's.
    """

    side, sensor, order = "observation", "encoders", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offset δ, rad: nine encoders in ten are within 3°; any may be off by more."""
        return (Parameter("offset", "rad", StudentT(3.0, 0.0, 0.02)),)

    def answer(self, p: Values, now: Situation) -> Tensor | None:
        """−S δ of a servo, within its limits."""
        for k, servo in self.servos.items():
            return now.at(k, answer_changed(servo, k, now, -servo.stiffness * p["offset"]))
        return None

    def angles(self, p: Values, view: View) -> Tensor:
        """θ + δ."""
        return with_entry(view.angles, self.place[0], self.own(view.angles) + p["offset"])
