"""Radial distortion of the lens: p (1 + k₁ |p|²), Brown's first term."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Values
from invdyn.models.effects.optics import Optics


class LensDistortion(Optics):
    """Points move along their radius from the frame's origin; k₁ > 0 is a pincushion, < 0 a barrel.

    Its growth with the third power of the radius distinguishes it from a scale.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Coefficient k₁, m⁻²."""
        return (Parameter("k1", "m⁻²", Normal(0.0, 0.08 / scale.reach**2)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """P (1 + k₁ |p|²)."""
        return points * (1 + p["k1"].unsqueeze(-1) * points.square().sum(-1, keepdim=True))
