"""What a camera makes of the whole picture about its centre c: p ↦ c + f(p − c)."""

from abc import abstractmethod

import torch
from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View, as_variant


class Optics(Effect):
    """Base of the camera's effects on all points: about the frame's origin, in the variant about any centre.

    The origin is a choice of the calibration, and no property of the lens, as its centre is.
    """

    planar = True
    side, site, order = "observation", "arm", 2

    def nonideal(self) -> Effect | None:
        """About any centre."""
        return None if self.variant else as_variant(self, 1)

    @abstractmethod
    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of f."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of f; in the variant the centre, m."""
        if not self.variant:
            return self.about_origin(scale)
        prior, grid = Normal(0.0, 0.5 * scale.reach), (-0.4 * scale.reach, 0.4 * scale.reach)
        centre = (Parameter(f"centre_{axis}", "m", prior, None, grid) for axis in "xy")
        return (*self.about_origin(scale), *centre)

    @abstractmethod
    def seen(self, p: Values, points: Tensor) -> Tensor:
        """What f makes of points (..., K, 2) m."""

    def points(self, p: Values, view: View) -> Tensor:
        """The picture, c + f(p − c)."""
        if not self.variant:
            return self.seen(p, view.points)
        centre = torch.cat(torch.broadcast_tensors(p["centre_x"], p["centre_y"]), -1).unsqueeze(-2)
        return centre + self.seen(p, view.points - centre)
