"""Viscous friction that changes over the recording: −(b₀ + s t) θ̇."""

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale


class DriftingFriction(Effect):
    """A damping that warms up or wears in on a straight line, t from the first row; never below 0.

    Told apart from plain viscous friction by repeating a clip.
    """

    phrase = "drifting friction"
    meaning = "friction that changes during the recording"
    shown_by = "the first motion again at the end"

    dated = True

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
        j = self.place[0]
        damping = (p["damping"] + p["slope"] * now.elapsed).clamp_min(0.0)
        return now.at(j, -damping * now.qd[..., j : j + 1])
