"""Dry friction that falls with speed: −(τ_c + (τ_s − τ_c) e^{−(θ̇/ω_s)²}) sgn θ̇ (Stribeck's curve)."""

import torch
from pyro.distributions import HalfNormal, LogNormal
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Situation, Values, quantiles
from invdyn.models.effects.regularised_friction import RegularisedFriction


class StribeckFriction(RegularisedFriction):
    """Coulomb friction τ_c in motion, more of it, τ_s, when slow: below about ω_s.

    Linear in τ_c and τ_s for a given ω_s. Slow reversals distinguish it from Coulomb friction.
    """

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction in motion τ_c and near rest τ_s, N·m; speed ω_s of the change, rad/s."""
        j = self.place[0]
        velocity = LogNormal(torch.tensor(0.35 * scale.speed[j]).log().item(), 0.6)
        return (
            Parameter("coulomb", "N·m", HalfNormal(0.2 * scale.torque[j])),
            Parameter("static", "N·m", HalfNormal(0.4 * scale.torque[j])),
            Parameter("velocity", "rad/s", velocity, None, quantiles(velocity, 5)),
        )

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c (1 − e) + τ_s e with e = exp(−(θ̇/ω_s)²)."""
        slow = torch.exp(-((self.own(now.qd) / p["velocity"]) ** 2))
        return p["coulomb"] * (1 - slow) + p["static"] * slow
