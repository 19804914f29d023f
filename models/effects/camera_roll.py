"""A camera that is not level: R(α) p, the picture turned about the frame's origin."""

from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import StudentT
from torch import Tensor

from invdyn.models.effects.base import Parameter, Values, rotated
from invdyn.models.effects.optics import Optics
from invdyn.models.effects.scale import Scale


class CameraRoll(Optics):
    """All points turned counter-clockwise by an angle about the origin.

    With the base at the origin it cannot be told from tilted gravity, unless the picture shows how the base lies or
    encoders count from it.
    """

    phrase = "camera roll"
    meaning = "a picture turned about the line of sight"
    shown_by = "encoders and a camera together, or the base's own edges in view of the camera"
    twins: ClassVar[Mapping[str, Mapping[str, str]]] = {"gravity_tilt": {"angle": "angle"}}

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad: nine cameras in ten are level to 3°, as few bases are (:mod:`.gravity_tilt`); any may be."""
        return (Parameter("angle", "rad", StudentT(3.0, 0.0, 0.02)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """R(angle) p."""
        return rotated(points, p["angle"].unsqueeze(-1))
