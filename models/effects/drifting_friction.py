"""Viscous friction that changes over the recording: −(b₀ + s t) θ̇."""

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values


class DriftingFriction(Effect):
    """Damping that warms up or wears in, linear in the time t since the first row; never below 0.

    A repeated motion distinguishes it from constant viscous friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping at the start b₀, N·m·s/rad, and its slope s, N·m/rad."""
        j = self.place[0]
        damping = 0.2 * scale.torque[j] / scale.speed[j]
        return (
            Parameter("damping", "N·m·s/rad", HalfNormal(damping)),
            Parameter("slope", "N·m/rad", Normal(0.0, 2 * damping / scale.duration)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """−max(0, b₀ + s t) θ̇."""
        damping = (p["damping"] + p["slope"] * now.elapsed).clamp_min(0.0)
        return now.at(self.place[0], -damping * self.own(now.qd))
