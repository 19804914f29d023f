"""A torque that repeats with the motor's angle: A sin(N θ + φ), the cogging of its poles."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from pyro.distributions import LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import MARGIN, Effect, Parameter, Values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

PERIODS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40, 48)

FEWEST = 3.0
"""Periods a turn; motors' builds have four or more (``PERIODS``)."""


class TorqueRipple(Effect):
    """Torque a sin Nθ + b cos Nθ = A sin(Nθ + φ) at a joint.

    Told apart from a spring by slow sweeps over many periods. As ``cogging`` in MuJoCo. Poles are no perfect sines: the
    softer form has the second harmonic, a₂ sin 2Nθ + b₂ cos 2Nθ, too.
    """

    phrase = "torque ripple"
    meaning = "a torque that repeats with the joint's angle"
    shown_by = "a slow sweep through the whole range"

    softens: ClassVar[bool] = True
    form_words: ClassVar[Mapping[str, str]] = {
        "second_amplitude": "no pure sine, it has a second wave of twice as many periods",
    }

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parts a and b, N·m, and periods N a turn, which the motor's build makes whole; a₂ and b₂."""
        typical = 0.05 * scale.effort[self.place[0]]
        first, second = Normal(0.0, typical), Normal(0.0, 0.5 * typical)
        return (
            Parameter("sine", "N·m", first),
            Parameter("cosine", "N·m", first),
            Parameter("periods", "1", LogNormal(2.4, 0.7), None, tuple(map(float, PERIODS))),
            *(Parameter(f"second_{part}", "N·m", second) for part in ("sine", "cosine") if self.soft),
        )

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """No second harmonic."""
        return {**ideal, "second_sine": 0.0, "second_cosine": 0.0}

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """Amplitude A, N·m, phase φ, rad, and periods N; amplitude and phase of the second harmonic."""
        first = _wave(values["sine"], values["cosine"])
        second = _wave(values["second_sine"], values["second_cosine"], "second_") if self.soft else {}
        return {**first, "periods": (values["periods"], "1"), **second}

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """No fewer periods than ``FEWEST``: slower waves are springs and weights, not a motor's build."""
        return mean["periods"] + MARGIN * sd["periods"] >= FEWEST

    def force(self, p: Values, now: Situation) -> Tensor:
        """Of both harmonics."""
        j = self.place[0]
        angle = p["periods"] * now.q[..., j : j + 1]
        torque = p["sine"] * angle.sin() + p["cosine"] * angle.cos()
        if self.soft:
            torque = torque + p["second_sine"] * (2 * angle).sin() + p["second_cosine"] * (2 * angle).cos()
        return now.at(j, torque)


def _wave(sine: Tensor, cosine: Tensor, which: str = "") -> dict[str, tuple[Tensor, str]]:
    return {
        f"{which}amplitude": (torch.hypot(sine, cosine), "N·m"),
        f"{which}phase": (torch.atan2(cosine, sine), "rad"),
    }
