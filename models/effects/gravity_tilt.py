"""Gravity from another direction, as the frame is not level: R(α) g."""

from collections.abc import Sequence
from typing import Any, Self

import torch
from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.bodies.protocol import AXES, ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Values, rotated


class GravityTilt(Effect):
    """Gravity rotated by an angle, in the frame of the body and of the camera.

    In the plane counter-clockwise; only encoders or a picture of the base distinguish it from a rolled camera. A plumb
    line does not: both rotate it. In space the base leans about the two axes of the frame that are nearest to level: a
    rotation vector of these two coordinates.
    """

    site = "arm"
    about: tuple[int, ...] = ()
    """Axes of the frame about which it may rotate, by number; none in the plane."""

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """One, where there is gravity."""
        return [cls()] if any(body.gravity) else []

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        if body.dimensions == 3:
            upright = max(range(3), key=lambda axis: abs(body.gravity[axis]))
            other.about = tuple(axis for axis in range(3) if axis != upright)
        return other

    @property
    def _names(self) -> tuple[str, ...]:
        return tuple(f"about_{AXES[axis]}" for axis in self.about) or ("angle",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle, rad; in space two."""
        return tuple(Parameter(name, "rad", Normal(0.0, 0.15)) for name in self._names)

    def body(self, p: Values, body: Any) -> Any:
        """R g."""
        if not self.about:
            return body._replace(gravity=rotated(body.gravity, p["angle"]))
        angles = [p[name][..., 0] for name in self._names]
        vector = [torch.zeros_like(angles[0])] * 3
        for axis, angle in zip(self.about, angles, strict=True):
            vector[axis] = angle
        return body._replace(gravity=turned(body.gravity, torch.stack(vector, -1)))


def turned(vector: Tensor, by: Tensor) -> Tensor:
    """Vectors (..., 3) rotated by rotation vectors (..., 3), rad (Rodrigues): smooth where these are 0."""
    vector, by = torch.broadcast_tensors(vector, by)
    angle = (by.square().sum(-1, keepdim=True) + 1e-30).sqrt()
    once = torch.linalg.cross(by, vector)
    twice = torch.linalg.cross(by, once)
    return vector + torch.sinc(angle / torch.pi) * once + 0.5 * torch.sinc(angle / (2 * torch.pi)) ** 2 * twice
