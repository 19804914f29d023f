"""Radial distortion of the lens: p (1 + k₁ |p|²), Brown's first term."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class LensDistortion(Effect):
    """Points move along their radius from the frame's origin; k₁ > 0 is a pincushion, < 0 a barrel.

    Told apart from a scale by its growth with the third power of the radius.
    """

    side, site, order = "observation", "arm", 2

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Coefficient k₁, m⁻²."""
        return (Parameter("k1", "m⁻²", Normal(0.0, 0.08 / scale.reach**2)),)

    def points(self, p: Values, view: View) -> Tensor:
        """P (1 + k₁ |p|²)."""
        return view.points * (1 + p["k1"].unsqueeze(-1) * view.points.square().sum(-1, keepdim=True))
