"""A tracker that takes one keypoint for another: with probability ρ it shows (p_j, p_i) in place of (p_i, p_j)."""

from collections.abc import Sequence
from itertools import combinations
from typing import Self

from pyro.distributions import Beta

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View
from invdyn.models.observation.tracker_errors import Swap


class LabelSwap(Effect):
    """In a share ρ of the rows both keypoints named carry each other's detection.

    Its symmetry distinguishes it from outliers.
    """

    side, site = "observation", "keypoints"

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """Every pair of tracked keypoints."""
        return [cls(*pair) for pair in combinations(keypoints, 2)]

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ of rows."""
        return (Parameter("rate", "1", Beta(1.0, 25.0), 0.0, (0.003, 0.01, 0.03, 0.1)),)

    def outlier(self, p: Values, view: View) -> Swap:
        """The pair, exchanged with probability ρ."""
        one, other = self.place
        return Swap(one, other, p["rate"])
