"""Detections that get worse in fast motion, σ (1 + slope |ṗ|) or σ (1 + slope |θ̇|), or as the tracker says,
σ (1 + slope (1 − c)).
"""

from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

from pyro.distributions import Exponential
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.view import View


class VaryingNoise(Effect):
    """A keypoint's noise grows with its speed, in all directions alike; ``VaryingNoise("confidence")``: as c falls;
    ``VaryingNoise("joints")``: all keypoints' alike, with how fast the joints turn, |θ̇| over all of them.

    Only the variance changes: told apart from process noise by frames at rest.
    """

    phrase = "varying noise"
    meaning = "positions that are less certain in some frames than in others"
    shown_by = "the same postures held still"
    form_words: ClassVar[Mapping[str, str]] = {
        "confidence": "as the tracker’s confidence falls",
        "joints": "with how fast the joints turn",
    }

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
        """Every form; of a single joint its speed is the keypoint's, and says nothing else."""
        found = super().everywhere(body, keypoints)
        return [effect for effect in found if effect.form != "joints" or body.num_joints > 1]

    def tellable(self, commanded: bool, confident: bool) -> bool:
        """See :meth:`Effect.tellable`."""
        return confident or self.form != "confidence"

    def noise(self, p: Values, view: View, sd: Tensor) -> Tensor:
        """See the top of the file; σ where nobody says how sure the tracker was."""
        # a floor on the root keeps the gradient at rest finite
        if self.form == "joints":
            turning = (view.qd.square().sum(-1, keepdim=True) + 1e-12).sqrt()
            return sd * (1 + p["slope"] * turning).unsqueeze(-1)
        if self.form:
            return sd if view.doubt is None else sd * (1 + p["slope"].unsqueeze(-1) * view.doubt.unsqueeze(-1))
        speed = (view.velocity.square().sum(-1, keepdim=True) + 1e-12 * view.dynamics.reach(view.body) ** 2).sqrt()
        return sd * (1 + p["slope"].unsqueeze(-1) * speed)
