"""Detections that get worse with motion blur: σ (1 + slope |ṗ|)."""

from pyro.distributions import Exponential
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class VaryingNoise(Effect):
    """A keypoint's noise grows with its speed, in all directions alike.

    Only the variance changes: told apart from process noise by frames at rest.
    """

    side, site = "observation", "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Slope, s/m; at the speed of the outstretched arm the noise is tenfold, give or take as much."""
        return (Parameter("slope", "s/m", Exponential(scale.speed[0] * scale.reach / 10.0)),)

    def noise(self, p: Values, view: View, sd: Tensor) -> Tensor:
        """σ (1 + slope |ṗ|)."""
        # a floor on the root keeps the gradient at rest finite
        speed = (view.tip_velocity.square().sum(-1, keepdim=True) + 1e-12 * view.body.length.sum() ** 2).sqrt()
        return sd * (1 + p["slope"].unsqueeze(-1) * speed)
