"""A spring in a joint: −k (θ − θ₀)."""

import math
from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import MARGIN, Effect, Parameter, Values
from invdyn.models.effects.change import change
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

TURNS = 2
"""Whole turns within which a rest angle is told: of one that is farther nobody would see the spring."""
FARTHEST = 2 * math.pi * TURNS
"""The same in rad."""
CONSTANT = "such a spring is a constant torque, as of an encoder that is off beside a servo; the catalogue has none"
"""What a rest angle that far means."""


class JointStiffness(Effect):
    """Torque −k (θ − θ₀) at a joint: passive tissue, a cable, a counterbalance.

    Given by its stiffness and by its torque where θ = 0, T₀ = k θ₀, both of which the motion follows in a straight
    line. Told apart from a tilt or an armature by the rest pose and the frequency. ``stiffness``, ``springref`` in
    MuJoCo.
    """

    phrase = "joint stiffness"
    meaning = "a spring that pulls the joint to a rest angle"
    shown_by = "holding still in several postures"
    filed: ClassVar[Mapping[str, str]] = {"stiffness": "stiffness"}

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and torque at angle zero T₀, N·m, for rest angles anywhere on a circle."""
        j = self.place[0]
        torque = scale.torque[j]
        return (
            change("stiffness", "N·m/rad", 0.5 * torque, scale.filed("stiffness", j)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
        )

    edges: ClassVar[Mapping[str, tuple[float, str]]] = {"rest_angle": (FARTHEST, CONSTANT)}

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """Stiffness k, N·m/rad, and rest angle θ₀ = T₀/k, rad."""
        rest = (values["torque"] / values["stiffness"].clamp_min(1e-12)).clamp(-FARTHEST, FARTHEST)
        return {"stiffness": (values["stiffness"], "N·m/rad"), "rest_angle": (rest, "rad")}

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """A rest angle within a turn; of one that is farther away the spring would show as a constant torque alone.

        Springs that were found where there were some rested at 2.5 rad at most.
        """
        return abs(mean["torque"]) <= 2 * math.pi * (mean["stiffness"] + MARGIN * sd["stiffness"])

    def force(self, p: Values, now: Situation) -> Tensor:
        """T₀ − k θ."""
        j = self.place[0]
        return now.at(j, p["torque"] - p["stiffness"] * now.q[..., j : j + 1])
