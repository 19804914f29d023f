"""A spring across two joints: potential ½ k (θ_i − r θ_j − θ₀)²."""

import math
from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import MARGIN, Effect
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.joint_stiffness import CONSTANT, FARTHEST
from invdyn.models.effects.parameter import Parameter, Values, quantiles
from invdyn.models.effects.scale import Scale

LEAST = 0.1
"""Ratio of lever arms under which it is a spring of one joint; couplings that were found where there were some had .52
or more."""


class JointCoupling(Effect):
    """Torque T₀ − k (θ_i − r θ_j) at the second joint named, i, and r times its opposite at the first, j.

    What a muscle or a tendon over two joints does, which is slack in some posture: T₀ = k θ₀. Told apart from either
    joint's own stiffness by moving them apart. As a fixed ``tendon`` with a ``springlength`` in MuJoCo.
    """

    phrase = "joint coupling"
    meaning = "a spring between two joints"
    shown_by = "moving one joint while the other is held"

    site = "pair"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, torque T₀ with both angles at zero, N·m, and ratio r of the two lever arms, a pure
        number of either sign.
        """
        ratio, torque = Normal(0.0, 0.9), scale.torque[self.place[1]]
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * torque)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
            Parameter("ratio", "1", ratio, None, quantiles(ratio, 6)),
        )

    edges: ClassVar[Mapping[str, tuple[float, str]]] = {"rest_angle": (FARTHEST, CONSTANT)}

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """Stiffness k, N·m/rad, ratio r, and θ₀ = T₀/k, rad, of θ_i − r θ_j where the spring is slack."""
        rest = (values["torque"] / values["stiffness"].clamp_min(1e-12)).clamp(-FARTHEST, FARTHEST)
        return {
            "stiffness": (values["stiffness"], "N·m/rad"),
            "ratio": (values["ratio"], "1"),
            "rest_angle": (rest, "rad"),
        }

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """A spring that minds both joints, and is slack within a turn of each."""
        turns = 1 + abs(mean["ratio"]) + MARGIN * sd["ratio"]
        slack = abs(mean["torque"]) <= 2 * math.pi * turns * (mean["stiffness"] + MARGIN * sd["stiffness"])
        return slack and abs(mean["ratio"]) + MARGIN * sd["ratio"] > LEAST

    def force(self, p: Values, now: Situation) -> Tensor:
        """(T₀ − k (θ_i − r θ_j)) (e_i − r e_j)."""
        j, i = self.place
        pull = p["torque"] - p["stiffness"] * (now.q[..., i : i + 1] - p["ratio"] * now.q[..., j : j + 1])
        return now.at(i, pull) - now.at(j, p["ratio"] * pull)
