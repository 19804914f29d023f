"""Frames whose true moments scatter about their time stamps: errors in proportion to speed."""

from pyro.distributions import HalfNormal, Uniform

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View
from invdyn.models.mixture import Stray


class TimestampJitter(Effect):
    """A share ρ of the detections is mistimed by s/√ρ (standard deviation), by s over all of them.

    A coordinate that moves with v and a is off by δ v + δ² a/2 at a time that is off by δ.
    In truth all keypoints of a frame are mistimed together; here each has its own chance, which costs power, not truth.
    Told apart from noise by its growth with speed, along the motion only.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ, and standard deviation s over all detections, s, of up to a frame."""
        return (
            Parameter("rate", "1", Uniform(0.0, 1.0), 0.0, (0.1, 0.4, 0.9)),
            Parameter("sd", "s", HalfNormal(0.02), 0.0, (0.003, 0.01, 0.03)),
        )

    def mistake(self, p: Values, view: View) -> Stray:
        """(1 − ρ) N(h, σ²) + ρ N(h, σ² + E[(δ v + δ² a/2)²]), the expectation s_δ² v² + ¾ s_δ⁴ a², s_δ = s/√ρ."""
        each = (p["sd"] / p["rate"].clamp_min(1e-9).sqrt()).unsqueeze(-1)  # none is mistimed at a rate of 0
        off = view.tip_velocity**2 + 0.75 * (each * view.tip_acceleration) ** 2
        return Stray(p["rate"], each * (off + 1e-24).sqrt())  # a floor keeps the gradient at rest finite
