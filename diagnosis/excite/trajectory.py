"""Motions that start and end at rest, within limits of angle, speed and acceleration by construction.

    θ_j(t) = c_j + s_j w(t) f_j(t),     f_j(t) = Σ_l a_jl cos(2π n_l t/T) + b_jl sin(2π n_l t/T)

Finite Fourier series (Swevers, Ganseman, Tükel, de Schutter & Van Brussel 1997). w rises from 0 to 1 at both ends by
6 u⁵ − 15 u⁴ + 10 u³, so that speed and acceleration are 0 there. The scale s_j is the largest that keeps to what is
left of the range about the centre c_j, to the speed and to the acceleration, times a share of its own.

Shapes: R rows, K joints, L harmonics. Units: s, rad, rad/s, rad/s².
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.excite.limits import MotionLimits
from invdyn.diagnosis.rules import FIXED


class Path(NamedTuple):
    """Angles, velocities and accelerations (R, K)."""

    q: Tensor
    qd: Tensor
    qdd: Tensor


class Coefficients(NamedTuple):
    """Free numbers: `waves` (K, 2 L), `centre` (K,) and `share` (K,), which stand for tanh and a logistic."""

    waves: Tensor
    centre: Tensor
    share: Tensor


@dataclass(frozen=True)
class Family:
    """All motions of T ``seconds`` within ``limits``, at ``rate`` rows a second."""

    limits: MotionLimits
    seconds: float
    rate: float

    @cached_property
    def time(self) -> Tensor:
        """(R,) s."""
        return torch.arange(round(self.seconds * self.rate) + 1, dtype=torch.float64) / self.rate

    @cached_property
    def harmonics(self) -> Tensor:
        """(L,) n: a fifth apart or more, as far as the highest frequency."""
        most = max(1, int(FIXED.excite_highest_frequency * self.seconds))
        return torch.tensor(np.unique(np.round(np.geomspace(1, most, 12))), dtype=torch.float64)

    @cached_property
    def _waves(self) -> tuple[Tensor, Tensor, Tensor]:
        """Windowed waves and their first two derivatives in time, (2 L, R) each."""
        w = 2 * torch.pi * self.harmonics[:, None] / self.seconds
        angle = w * self.time
        f = torch.cat([angle.cos(), angle.sin()])
        fd = torch.cat([-w * angle.sin(), w * angle.cos()])
        fdd = torch.cat([-(w**2) * angle.cos(), -(w**2) * angle.sin()])
        rise = min(FIXED.excite_rise, self.seconds / 4)
        u = torch.minimum(self.time, self.seconds - self.time).clamp(0, rise) / rise
        sign = torch.where(self.time < self.seconds / 2, 1.0, -1.0) * (u < 1)
        v = ((6 * u - 15) * u + 10) * u**3
        vd = 30 * u**2 * (1 - u) ** 2 * sign / rise
        vdd = (60 * u - 180 * u**2 + 120 * u**3) * (u < 1) / rise**2
        return v * f, vd * f + v * fd, vdd * f + 2 * vd * fd + v * fdd

    def start(self, generator: torch.Generator) -> Coefficients:
        """Random numbers to begin a search at."""
        K, L = len(self.limits.low), len(self.harmonics)
        waves = torch.randn(K, 2, L, generator=generator, dtype=torch.float64)
        centre = 0.3 * torch.randn(K, generator=generator, dtype=torch.float64)
        return Coefficients((waves / self.harmonics**0.5).flatten(1), centre, torch.full((K,), 3.0).double())

    def path(self, of: Coefficients) -> Path:
        """The motion; it keeps to the limits at all rows."""
        limits = {name: torch.as_tensor(getattr(self.limits, name)) for name in ("middle", "half")}
        speed, rise = torch.as_tensor(self.limits.speed), torch.as_tensor(self.limits.acceleration)
        offset = limits["half"] * FIXED.excite_centre * of.centre.tanh()
        shapes = [of.waves @ waves for waves in self._waves]
        room = limits["half"] - offset.abs()
        scales = [
            most / shape.abs().amax(1).clamp_min(1e-12) for most, shape in zip((room, speed, rise), shapes, strict=True)
        ]
        scale = torch.stack(scales).amin(0) * of.share.sigmoid()
        q, qd, qdd = (scale * shape.T for shape in shapes)
        return Path(limits["middle"] + offset + q, qd, qdd)

    def scaled(self, of: Coefficients, factor: float) -> Coefficients:
        """The same motion, its swings ``factor`` ≤ 1 times as wide."""
        share = (factor * of.share.sigmoid()).logit()
        return of._replace(share=share)

    def at(self, rate: float) -> "Family":
        """The same motions in other rows."""
        return Family(self.limits, self.seconds, rate)
