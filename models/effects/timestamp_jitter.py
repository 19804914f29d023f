"""Frames whose true moments scatter about their time stamps: errors in proportion to speed."""

import torch
from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class TimestampJitter(Effect):
    """Mistimed by s (standard deviation over all frames), a coordinate that moves with v scatters by s v more.

    Told apart from noise by its growth with speed, along the motion only.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Standard deviation s, s, of up to a frame."""
        return (Parameter("sd", "s", HalfNormal(0.02)),)

    def noise(self, p: Values, view: View, sd: Tensor) -> Tensor:
        """√(σ² + (s v)²)."""
        return torch.sqrt(sd**2 + (p["sd"].unsqueeze(-1) * view.tip_velocity) ** 2)
