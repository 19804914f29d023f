"""Detections that are worse in fast motion, σ (1 + slope |ṗ|) or σ (1 + slope |θ̇|), or by the tracker's confidence c,
σ (1 + slope (1 − c)).
"""

from collections.abc import Sequence
from typing import ClassVar, Self

import torch
from pyro.distributions import Exponential
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View


class VaryingNoise(Effect):
    """A keypoint's noise grows with its speed, in all directions; ``VaryingNoise("confidence")``: as c falls;
    ``VaryingNoise("joints")``: all keypoints' equally, with the joints' speed |θ̇| over all of them.

    Only the variance changes: frames at rest distinguish it from process noise.
    """

    side, site = "observation", "arm"
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
