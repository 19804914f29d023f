"""Frames whose true moments scatter about their time stamps by δ: keypoints at p + δ ṗ + ½ δ² p̈."""

from pyro.distributions import HalfNormal, Uniform

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View
from invdyn.models.observation.tracker_errors import Shift


class TimestampJitter(Effect):
    """A share ρ of the frames is mistimed by s/√ρ (standard deviation), by s over all of them.

    All keypoints of a frame are off by the same time δ, each by δ ṗ + δ² p̈/2. Errors that grow with speed, along the
    motion only, equally for all keypoints, distinguish it from noise.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ, and standard deviation s over all frames, s, of up to a frame."""
        return (
            Parameter("rate", "1", Uniform(0.0, 1.0), 0.0, (0.1, 0.4, 0.9)),
            Parameter("sd", "s", HalfNormal(0.02), 0.0, (0.003, 0.01, 0.03)),
        )

    def mistiming(self, p: Values, view: View) -> Shift:
        """(1 − ρ) N(h, σ²) + ρ N(h, σ² + s_δ² ṗ ṗᵀ + ¾ s_δ⁴ p̈²), s_δ = s/√ρ: the second order by its mean square."""
        each = (p["sd"] / p["rate"].clamp_min(1e-9).sqrt()).unsqueeze(-1)  # none is mistimed at a rate of 0
        scatter = 0.75**0.5 * each**2 * view.site_acceleration.abs()
        return Shift(p["rate"], each * view.velocity, scatter)
