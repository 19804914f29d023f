"""What trackers, encoders and clocks add: one effect a class.

clock_rate        frames taken at another rate than stated: their true times are t₀ + (t − t₀)/s
encoder_offset    an encoder whose zero is not the simulation's: θ + δ; a servo then holds another angle, off by δ
keypoint_offset   a marker that sits off its joint, fixed in its link's frame: p + a u + b u⊥
label_swap        a tracker that takes one keypoint for another: with probability ρ it shows (p_j, p_i)
outliers          detections from far away: (1 − ρ) N(p, σ²) + ρ N(p, σ² + s²)
timestamp_jitter  frames whose true moments scatter about their time stamps by δ: keypoints at p + δ ṗ + ½ δ² p̈
varying_noise     detections that are worse in fast motion, σ (1 + slope |ṗ|) or σ (1 + slope |θ̇|), or by the tracker's
                  confidence c, σ (1 + slope (1 − c))
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import ClassVar, Self

import torch
from pyro.distributions import Beta, Exponential, HalfNormal, LogNormal, Normal, StudentT, Uniform
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Situation, Values, View, quantiles, with_entry
from invdyn.models.effects.motors import OfServos, answer_changed
from invdyn.models.observation.view import Outlier, Shift, Swap


class ClockRate(Effect):
    """The frame clock runs at s times the stated rate: true time = stated time / s.

    One clock stamps all rows; commands stay in the rows in which they were recorded. In a passive recording only a
    known strength of gravity shows it. ``ClockRate("frames")`` are sensors with a clock of their own, while commands
    keep true time; both agree at the first row.
    """

    site, sensor, order = "arm", "any", 1
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
    sensor, site = "keypoints", "keypoint"

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

    sensor, site = "keypoints", "keypoints"

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

    sensor, site = "keypoints", "arm"

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

    sensor, site, order = "keypoints", "arm", 1

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


class EncoderOffset(OfServos):
    """A joint's encoder shows its angle and a constant δ more.

    Gravity shows it, by the weight of the links beyond the joint. Of a chain in the plane only a camera distinguishes
    the first joint's from tilted gravity. About an axis along gravity nothing shows the first joint's.
    """

    sensor, order = "encoders", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offset δ, rad: nine encoders in ten are within 3°; any may be off by more."""
        return (Parameter("offset", "rad", StudentT(3.0, 0.0, 0.02)),)

    def answer(self, p: Values, now: Situation) -> Tensor | None:
        """−S δ of a servo, within its limits."""
        for k, servo in self.servos.items():
            return now.at(k, answer_changed(servo, k, now, -servo.stiffness * p["offset"]))
        return None

    def angles(self, p: Values, view: View) -> Tensor:
        """θ + δ."""
        return with_entry(view.angles, self.place[0], self.own(view.angles) + p["offset"])


class VaryingNoise(Effect):
    """A keypoint's noise grows with its speed, in all directions; ``VaryingNoise("confidence")``: as c falls;
    ``VaryingNoise("joints")``: all keypoints' equally, with the joints' speed |θ̇| over all of them.

    Only the variance changes: frames at rest distinguish it from process noise.
    """

    sensor, site = "keypoints", "arm"
    forms: ClassVar[tuple[str, ...]] = ("confidence", "joints")

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Slope, s/m; at the speed of the outstretched arm the noise is tenfold, give or take as much.

        Of the joints' speed, s/rad, likewise. Of confidence, a pure number: where there is none the noise is tenfold.
        """
        if self.form == "joints":
            return (Parameter("slope", "s/rad", Exponential(scale.speed[0] / 10.0)),)
        if self.form:
            return (Parameter("slope", "1", Exponential(0.1)),)
        return (Parameter("slope", "s/m", Exponential(scale.speed[0] * scale.reach / 10.0)),)

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """Every form; the speed of a single joint is its keypoint's."""
        found = super().everywhere(body, keypoints)
        return [effect for effect in found if effect.form != "joints" or body.num_joints > 1]

    def noise(self, p: Values, view: View) -> Tensor:
        """See the top of the file; 1 where no tracker states its confidence."""
        slope = p["slope"].unsqueeze(-1)
        # a floor on the root keeps the gradient at rest finite
        if self.form == "joints":
            speed = (view.qd.square().sum(-1, keepdim=True) + 1e-12).sqrt()
            return (1 + p["slope"] * speed).unsqueeze(-1)
        if self.form:
            return torch.ones_like(slope) if view.doubt is None else 1 + slope * view.doubt.unsqueeze(-1)
        speed = (view.velocity.square().sum(-1, keepdim=True) + 1e-12 * view.dynamics.reach(view.body) ** 2).sqrt()
        return 1 + slope * speed
