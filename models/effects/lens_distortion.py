"""Radial distortion of the lens: p (1 + k₁ |p|²), Brown's first term."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.optics import Optics
from invdyn.models.effects.scale import Scale


class LensDistortion(Optics):
    """Points move along their radius from the frame's origin; k₁ > 0 is a pincushion, < 0 a barrel.

    Told apart from a scale by its growth with the third power of the radius.
    """

    phrase = "lens distortion"
    meaning = "positions bent outwards or inwards towards the picture's edge"
    shown_by = "a grid of known size that fills the picture"

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Coefficient k₁, m⁻²."""
        return (Parameter("k1", "m⁻²", Normal(0.0, 0.08 / scale.reach**2)),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """P (1 + k₁ |p|²)."""
        return points * (1 + p["k1"].unsqueeze(-1) * points.square().sum(-1, keepdim=True))
