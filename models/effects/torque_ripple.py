"""A torque that repeats with the motor's angle: A sin(N θ + φ), the cogging of its poles."""

from collections.abc import Mapping

import torch
from pyro.distributions import LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import MARGIN, Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation

PERIODS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40, 48)

FEWEST = 3.0
"""Periods a turn; motors' builds have four or more (``PERIODS``)."""


class TorqueRipple(Effect):
    """Torque a sin Nθ + b cos Nθ = A sin(Nθ + φ) at a joint.

    Told apart from a spring by slow sweeps over many periods. As ``cogging`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parts a and b, N·m, and periods N a turn, which the motor's build makes whole."""
        amplitude = Normal(0.0, 0.05 * scale.effort[self.place[0]])
        return (
            Parameter("sine", "N·m", amplitude),
            Parameter("cosine", "N·m", amplitude),
            Parameter("periods", "1", LogNormal(2.4, 0.7), None, tuple(map(float, PERIODS))),
        )

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """Amplitude A, N·m, phase φ, rad, and periods N."""
        sine, cosine = values["sine"], values["cosine"]
        return {
            "amplitude": (torch.hypot(sine, cosine), "N·m"),
            "phase": (torch.atan2(cosine, sine), "rad"),
            "periods": (values["periods"], "1"),
        }

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """No fewer periods than ``FEWEST``: slower waves are springs and weights, not a motor's build."""
        return mean["periods"] + MARGIN * sd["periods"] >= FEWEST

    def force(self, p: Values, now: Situation) -> Tensor:
        """A sin Nθ + b cos Nθ."""
        j = self.place[0]
        angle = p["periods"] * now.q[..., j : j + 1]
        return now.at(j, p["sine"] * angle.sin() + p["cosine"] * angle.cos())
