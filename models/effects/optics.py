"""What a camera makes of the whole picture about its centre c: p ↦ c + f(p − c)."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import torch
from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.view import View


class Optics(Effect):
    """Base of the camera's effects on all points: about the frame's origin, in the softer form about any centre.

    Where a frame has its origin is up to who calibrates it; what a lens is centred on, is not.
    """

    planar = True
    side, site, order = "observation", "arm", 2
    softens: ClassVar[bool] = True
    form_words: ClassVar[Mapping[str, str]] = {
        "centre_x": "about a centre of the picture that is not the frame’s origin",
    }

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """The centre at the origin."""
        return {**ideal, "centre_x": 0.0, "centre_y": 0.0}

    @abstractmethod
    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of f."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of f; in the softer form the centre, m."""
        if not self.soft:
            return self.about_origin(scale)
        prior, grid = Normal(0.0, 0.5 * scale.reach), (-0.4 * scale.reach, 0.4 * scale.reach)
        centre = (Parameter(f"centre_{axis}", "m", prior, None, grid) for axis in "xy")
        return (*self.about_origin(scale), *centre)

    @abstractmethod
    def seen(self, p: Values, points: Tensor) -> Tensor:
        """What f makes of points (..., K, 2) m."""

    def points(self, p: Values, view: View) -> Tensor:
        """The picture, c + f(p − c)."""
        if not self.soft:
            return self.seen(p, view.points)
        centre = torch.cat(torch.broadcast_tensors(p["centre_x"], p["centre_y"]), -1).unsqueeze(-2)
        return centre + self.seen(p, view.points - centre)
