"""Detections from far away: (1 − ρ) N(p, σ²) + ρ N(p, σ² + s²), with ρ the share of those that s scatters."""

import math

from pyro.distributions import Beta, LogNormal

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View
from invdyn.models.observation.tracker_errors import Outlier


class Outliers(Effect):
    """Every keypoint of every row is, with probability ρ, off by s more in both coordinates: a mixture.

    The links' lengths, which jump too, distinguish it from a push.
    """

    side, site = "observation", "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ of detections, and width s, m."""
        width, grid = LogNormal(math.log(0.2 * scale.reach), 0.7), (0.1 * scale.reach, 0.3 * scale.reach)
        return (
            Parameter("rate", "1", Beta(1.0, 15.0), 0.0, (0.003, 0.01, 0.03, 0.1)),
            Parameter("scale", "m", width, None, grid),
        )

    def outlier(self, p: Values, view: View) -> Outlier:
        """(1 − ρ) N(h, σ²) + ρ N(h, σ² + s²)."""
        return Outlier(p["rate"], p["scale"].unsqueeze(-1))
