"""Dry friction that falls with speed: −(τ_c + (τ_s − τ_c) e^{−(θ̇/ω_s)²}) sgn θ̇ (Stribeck's curve)."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from pyro.distributions import HalfNormal, LogNormal
from torch import Tensor

from invdyn.models.effects.base import MARGIN
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.parameter import Parameter, Values, quantiles
from invdyn.models.effects.regularised_friction import RegularisedFriction
from invdyn.models.effects.scale import Scale


class StribeckFriction(RegularisedFriction):
    """Coulomb friction τ_c in motion, more of it, τ_s, when slow: below about ω_s.

    A straight line in τ_c and τ_s for a given ω_s. Told apart from Coulomb friction by slow reversals.
    """

    phrase = "Stribeck friction"
    meaning = "friction that is largest at low speed and falls once the joint moves"
    shown_by = "very slow reversals"

    contains: ClassVar = {"coulomb_friction": {"coulomb": "torque", "static": "torque"}}

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction in motion τ_c and near rest τ_s, N·m; speed ω_s of the change, rad/s."""
        j = self.place[0]
        velocity = LogNormal(torch.tensor(0.35 * scale.speed[j]).log().item(), 0.6)
        return (
            Parameter("coulomb", "N·m", HalfNormal(0.2 * scale.torque[j])),
            Parameter("static", "N·m", HalfNormal(0.4 * scale.torque[j])),
            Parameter("velocity", "rad/s", velocity, None, quantiles(velocity, 5)),
        )

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """No less friction at rest than in motion."""
        return mean["static"] + MARGIN * sd["static"] > mean["coulomb"] - MARGIN * sd["coulomb"]

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c (1 − e) + τ_s e with e = exp(−(θ̇/ω_s)²)."""
        j = self.place[0]
        slow = torch.exp(-((now.qd[..., j : j + 1] / p["velocity"]) ** 2))
        return p["coulomb"] * (1 - slow) + p["static"] * slow
