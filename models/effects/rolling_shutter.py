"""A camera that reads its rows one after the other: a point at height y is seen at t + ρ y."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View


class RollingShutter(Effect):
    """The delay with which a point is seen depends on its height then: two steps from τ = 0, the slope at the first,

        τ ← τ + (ρ y(t + τ) − τ) / (1 − ρ ẏ(t)).

    ρ < 0 where the picture is read from its top. The product of velocity and height distinguishes it from latency.
    """

    planar = True
    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Time ρ per height, s/m."""
        return (Parameter("readout", "s/m", Normal(0.0, 0.15 / (max(scale.speed) * scale.reach))),)

    def points(self, p: Values, view: View) -> Tensor:
        """p(t + τ)."""
        readout = p["readout"].unsqueeze(-1)
        stretch = (1 - readout * view.velocity[..., 1:]).clamp_min(0.2)
        delay = readout * view.points[..., 1:] / stretch
        missed = readout * view.later(delay)[..., 1:] - delay
        return view.later(delay + missed / stretch)
