"""A torque that repeats with the motor's angle: A sin(N θ + φ), the cogging of its poles."""

from pyro.distributions import LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, as_variant

PERIODS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40, 48)


class TorqueRipple(Effect):
    """Torque a sin Nθ + b cos Nθ = A sin(Nθ + φ) at a joint.

    Slow sweeps over many periods distinguish it from a spring. As ``cogging`` in MuJoCo. Poles are no perfect sines:
    the variant has the second harmonic, a₂ sin 2Nθ + b₂ cos 2Nθ, too.
    """

    def nonideal(self) -> Effect | None:
        """With the second harmonic."""
        return None if self.variant else as_variant(self, 1)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parts a and b, N·m, and periods N a revolution, which the motor's build makes whole; a₂ and b₂."""
        typical = 0.05 * scale.effort[self.place[0]]
        first, second = Normal(0.0, typical), Normal(0.0, 0.5 * typical)
        return (
            Parameter("sine", "N·m", first),
            Parameter("cosine", "N·m", first),
            Parameter("periods", "1", LogNormal(2.4, 0.7), None, tuple(map(float, PERIODS))),
            *(Parameter(f"second_{part}", "N·m", second) for part in ("sine", "cosine") if self.variant),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """Of both harmonics."""
        angle = p["periods"] * self.own(now.q)
        torque = p["sine"] * angle.sin() + p["cosine"] * angle.cos()
        if self.variant:
            torque = torque + p["second_sine"] * (2 * angle).sin() + p["second_cosine"] * (2 * angle).cos()
        return now.at(self.place[0], torque)
