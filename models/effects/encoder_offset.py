"""An encoder that counts from elsewhere than the simulation's joint: it shows θ + δ.

A servo follows its encoder. So one that holds a target holds another angle, off by δ:

    τ = K c + u₀ − S (θ + δ) − D θ̇
"""

from pyro.distributions import StudentT
from torch import Tensor

from invdyn.models.effects.base import Parameter, Values, with_entry
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.servo_answer import OfServos, answer_changed
from invdyn.models.observation.view import View


class EncoderOffset(OfServos):
    """A joint's encoder shows its angle and δ more, all along.

    Gravity tells it, and the weight of the links beyond the joint. Of a chain in the plane the first joint's cannot be
    told from tilted gravity without a camera. About an axis along gravity nothing shows the first joint's.
    """

    phrase = "an encoder offset"
    meaning = "an encoder whose zero is not the simulation's"
    shown_by = "encoders and a camera together, or the base's own edges in view of the camera"

    side, sensor, order = "observation", "encoders", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offset δ, rad: nine encoders in ten are within 3°; any may be off by more."""
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
