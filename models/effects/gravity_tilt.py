"""Gravity from another direction: the frame is not level."""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

from pyro.distributions import Normal

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Values, rotated
from invdyn.models.effects.scale import Scale


class GravityTilt(Effect):
    """Gravity turned counter-clockwise by an angle, in the frame of the body and of the camera.

    Cannot be told from a rolled camera, unless the picture shows how the base lies or encoders count from it. A plumb
    line does not help: both turn it alike.
    """

    phrase = "tilted gravity"
    meaning = "gravity that points elsewhere than in the simulation"
    shown_by = "the joints' encoders, or the base's own edges in view of the camera"
    twins: ClassVar[Mapping[str, Mapping[str, str]]] = {"camera_roll": {"angle": "angle"}}

    planar = True
    site = "arm"

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """One, where there is gravity."""
        return [cls()] if cls.fits(body) and any(body.gravity) else []

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad."""
        return (Parameter("angle", "rad", Normal(0.0, 0.15)),)

    def body(self, p: Values, body: BodyParameters) -> BodyParameters:
        """R(angle) g."""
        return body._replace(gravity=rotated(body.gravity, p["angle"]))
