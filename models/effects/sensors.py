"""What trackers, encoders and clocks add: one effect a class.

clock_rate        frames taken at another rate than stated: their true times are t₀ + (t − t₀)/s
keypoint_offset   a marker that sits off its joint, fixed in its link's frame: p + a u + b u⊥
label_swap        a tracker that takes one keypoint for another: with probability ρ it shows (p_j, p_i)
outliers          detections from far away: (1 − ρ) N(p, σ²) + ρ N(p, σ² + s²)
timestamp_jitter  frames whose true moments scatter about their time stamps by δ: keypoints at p + δ ṗ + ½ δ² p̈
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import ClassVar, Self

from pyro.distributions import Beta, HalfNormal, LogNormal, Normal, Uniform
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, View, quantiles
from invdyn.models.observation.tracker_errors import Outlier, Shift, Swap


class ClockRate(Effect):
    """The frame clock runs at s times the stated rate: true time = stated time / s.

    One clock stamps all rows; commands stay in the rows in which they were recorded. In a passive recording only a
    known strength of gravity shows it. ``ClockRate("frames")`` are sensors with a clock of their own, while commands
    keep true time; both agree at the first row.
    """

    side, site, sensor, order = "observation", "arm", "any", 1
    forms: ClassVar[tuple[str, ...]] = ("frames",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Rate s, a pure number."""
        prior = LogNormal(0.0, 0.15)
        # By the end of a recording even a little of it is late by as much as commands take to change.
        return (Parameter("rate", "1", prior, 1.0, quantiles(prior, 24) if self.form else ()),)

    def command(self, p: Values, command: Command) -> Command:
        """The command at the true time, t_0 + (t − t_0) / s."""
        return command.paced(p["rate"]) if self.form else command

    def interval(self, p: Values, dt: Tensor) -> Tensor:
        """δ / s."""
        return dt / p["rate"]


class KeypointOffset(Effect):
    """The keypoint at a link's tip sits ``along`` (outwards) and ``across`` (counter-clockwise) from it.

    It rotates with the link. Along the link only a measured length distinguishes it from the link's.
    """

    planar = True
    side, site = "observation", "keypoint"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offsets, m."""
        prior = Normal(0.0, 0.05 * scale.body.length[self.place[0]].item())
        return Parameter("along", "m", prior), Parameter("across", "m", prior)

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved by a u + b u⊥."""
        k = self.place[0]
        return view.moved(k, p["along"] * view.along[..., k, :] + p["across"] * view.across[..., k, :])


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


class TimestampJitter(Effect):
    """A share ρ of the frames is mistimed by s/√ρ (standard deviation), by s over all of them.

    All keypoints of a frame are off by the same time δ, each by δ ṗ + δ² p̈/2. Errors that grow with speed, along the
    motion only, equally for all keypoints, distinguish it from noise.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Share ρ, and standard deviation s over all frames, s, of up to a frame."""
        return (
            Parameter("rate", "1", Uniform(0.0, 1.0), 0.0, (0.1, 0.4, 0.9)),
            Parameter("sd", "s", HalfNormal(0.02), 0.0, (0.003, 0.01, 0.03)),
        )

    def mistiming(self, p: Values, view: View) -> Shift:
        """(1 − ρ) N(h, σ²) + ρ N(h, σ² + s_δ² ṗ ṗᵀ + ¾ s_δ⁴ p̈²), s_δ = s/√ρ: the second order by its mean square."""
        each = (p["sd"] / p["rate"].clamp_min(1e-9).sqrt()).unsqueeze(-1)  # none is mistimed at a rate of 0
        scatter = 0.75**0.5 * each**2 * view.site_acceleration.abs()
        return Shift(p["rate"], each * view.velocity, scatter)
