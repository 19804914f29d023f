"""A camera that is not level: R(α) p, the picture rotated about the frame's origin."""

from pyro.distributions import StudentT
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Values, rotated
from invdyn.models.effects.optics import Optics


class CameraRoll(Optics):
    """All points rotated counter-clockwise by an angle about the origin.

    With the base at the origin, only encoders or a picture of the base distinguish it from tilted gravity.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad: nine cameras in ten are level to 3°, as few bases are (:mod:`.gravity_tilt`); any may be."""
        return (Parameter("angle", "rad", StudentT(3.0, 0.0, 0.02)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """R(angle) p."""
        return rotated(points, p["angle"].unsqueeze(-1))
