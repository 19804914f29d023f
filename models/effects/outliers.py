"""Detections from far away: (1 − ρ) N(p, σ²) + ρ N(p, σ² + s²), with ρ the share of those that are s off."""

import math

from pyro.distributions import Beta, LogNormal

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.tracker_errors import Outlier
from invdyn.models.observation.view import View


class Outliers(Effect):
    """Every keypoint of every row is, with probability ρ, off by s more in both coordinates: a mixture.

    Told apart from a push by the links' lengths, which jump too.
    """

    phrase = "outliers"
    meaning = "some detections that are far from where the keypoint is"
    shown_by = "the same motion filmed from elsewhere"

    side, site = "observation", "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ of detections, and width s, m."""
        return (
            Parameter("rate", "1", Beta(1.0, 15.0), 0.0, (0.003, 0.01, 0.03, 0.1)),
            Parameter(
                "scale", "m", LogNormal(math.log(0.2 * scale.reach), 0.7), None, (0.1 * scale.reach, 0.3 * scale.reach)
            ),
        )

    def mistake(self, p: Values, view: View) -> Outlier:
        """(1 − ρ) N(h, σ²) + ρ N(h, σ² + s²)."""
        return Outlier(p["rate"], p["scale"].unsqueeze(-1))
