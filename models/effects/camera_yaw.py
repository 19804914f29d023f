"""The plane of motion seen obliquely: (x cos ψ, y) D / (D + x sin ψ)."""

import math

import torch
from pyro.distributions import LogNormal, StudentT
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Values
from invdyn.models.effects.optics import Optics


class CameraYaw(Optics):
    """The plane is rotated by ψ about the vertical through the origin, its +x side away from the camera at D.

    What is farther away looks smaller: that asymmetry distinguishes it from a scale.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle ψ, rad: few cameras stand far from square; distance D of the camera from the origin, m."""
        distance = LogNormal(math.log(3.5 * scale.reach), 0.4)
        return (
            Parameter("angle", "rad", StudentT(3.0, 0.0, 0.085), 0.0, (-0.2, -0.12, -0.06, 0.06, 0.12, 0.2)),
            Parameter("distance", "m", distance, None, tuple(n * scale.reach for n in (2.0, 3.5, 6.0))),
        )

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """Perspective about the origin."""
        angle, distance = p["angle"], p["distance"]
        x, y = points.unbind(-1)
        away = (distance + x * angle.sin()).maximum(0.1 * distance)  # nothing is behind the camera
        return torch.stack(torch.broadcast_tensors(x * angle.cos(), y), -1) * (distance / away).unsqueeze(-1)
