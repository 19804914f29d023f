"""A link's mass, centre of mass and inertia about that, in the plane or in space, and what a point mass makes of them.

    plane   com (..., 1) m along the link           moments (..., 1) about the hinge's axis
    space   com (..., 3) m in the link's frame      moments (..., 6): xx, yy, zz, xy, xz, yz

A point mass m at t makes of (M, c, I), with μ = M m/(M + m) and d = t − c (parallel axes, Huygens and Steiner),

    M + m,    (M c + m t)/(M + m),    I + μ (|d|² E − d dᵀ),

in the plane I + μ d². With −m it is taken off again. Units: kg, m, kg·m².
"""

from typing import NamedTuple

import torch
from torch import Tensor

SMALLEST = 1e-12
"""kg, so that nothing is divided by a mass of 0."""


class Inertia(NamedTuple):
    """Of one link: mass (..., 1), com (..., n) and moments (..., r); see the top of the file."""

    mass: Tensor
    com: Tensor
    moments: Tensor

    @property
    def mean(self) -> Tensor:
        """The mean of the principal moments, (..., 1)."""
        return self.moments if self.moments.shape[-1] == 1 else self.moments[..., :3].mean(-1, keepdim=True)

    @property
    def shape(self) -> Tensor:
        """The moments of a body as stretched as this one whose mean is one; of a ball where there are none."""
        ball = torch.zeros_like(self.moments)
        ball[..., :3] = 1.0
        return torch.where(self.mean > 0, self.moments / self.mean.clamp_min(1e-300), ball)

    def loaded(self, mass: Tensor, at: Tensor) -> "Inertia":
        """With a point mass (..., 1) at (..., n)."""
        total = (self.mass + mass).clamp_min(SMALLEST)
        com = (self.mass * self.com + mass * at) / total
        return Inertia(self.mass + mass, com, self.moments + self.mass * mass / total * point_moments(at - self.com))


def point_moments(d: Tensor) -> Tensor:
    """Moments (..., r) of one kilogram at d (..., n)."""
    if d.shape[-1] == 1:
        return d**2
    x, y, z = d.unbind(-1)
    return torch.stack([y**2 + z**2, x**2 + z**2, x**2 + y**2, -x * y, -x * z, -y * z], -1)
