"""A spring across two joints: potential ½ k (θ_i − r θ_j)²."""

from collections.abc import Mapping

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import MARGIN, Effect, Parameter, Values, quantiles
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

LEAST = 0.1
"""Ratio of lever arms under which it is a spring of one joint; couplings that were found where there were some had .52
or more."""


class JointCoupling(Effect):
    """Torque −k (θ_i − r θ_j) at the second joint named, i, and r times its opposite at the first, j.

    What a muscle or a tendon over two joints does. Told apart from either joint's own stiffness by moving them apart.
    As a fixed ``tendon`` in MuJoCo.
    """

    phrase = "joint coupling"
    meaning = "a spring between two joints"
    shown_by = "moving one joint while the other is held"

    site = "pair"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and ratio r of the two lever arms, a pure number of either sign."""
        ratio = Normal(0.0, 0.9)
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * scale.torque[self.place[1]])),
            Parameter("ratio", "1", ratio, None, quantiles(ratio, 6)),
        )

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """A spring that minds both joints."""
        return abs(mean["ratio"]) + MARGIN * sd["ratio"] > LEAST

    def force(self, p: Values, now: Situation) -> Tensor:
        """−k (θ_i − r θ_j) (e_i − r e_j)."""
        j, i = self.place
        pull = -p["stiffness"] * (now.q[..., i : i + 1] - p["ratio"] * now.q[..., j : j + 1])
        return now.at(i, pull) - now.at(j, p["ratio"] * pull)
