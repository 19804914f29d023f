"""A link's mass, centre of mass and inertia about that, of a chain in the plane or a tree in space, read and written.

    plane   com (..., 1) m along the link           moments (..., 1) about the hinge's axis
    space   com (..., 3) m in the link's frame      moments (..., 6): xx, yy, zz, xy, xz, yz

A point mass m at t makes of (M, c, I), with μ = M m/(M + m) and d = t − c (parallel axes, Huygens and Steiner),

    M + m,    (M c + m t)/(M + m),    I + μ (|d|² E − d dᵀ),

in the plane I + μ d². Units: kg, m, kg·m².
"""

from typing import NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.tree_parameters import TreeParameters
from invdyn.models.effects.base import with_entry

Numbers = BodyParameters | TreeParameters
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


def has_inertias(body: ArticulatedBody) -> bool:
    """Whether its links' numbers are of a kind that is known here."""
    return isinstance(body, Body)


def inertia_of(numbers: Numbers, link: int) -> Inertia:
    """A link's."""
    mass = numbers.mass[..., link : link + 1]
    if isinstance(numbers, BodyParameters):
        return Inertia(mass, numbers.com[..., link : link + 1], numbers.inertia[..., link : link + 1])
    return Inertia(mass, numbers.com[..., link, :], numbers.inertia[..., link, :])


def with_inertia(numbers: Numbers, link: int, own: Inertia) -> Numbers:
    """The numbers with a link's."""
    mass = with_entry(numbers.mass, link, own.mass)
    if isinstance(numbers, BodyParameters):
        com, inertia = with_entry(numbers.com, link, own.com), with_entry(numbers.inertia, link, own.moments)
    else:
        com, inertia = _with_row(numbers.com, link, own.com), _with_row(numbers.inertia, link, own.moments)
    return numbers._replace(mass=mass, com=com, inertia=inertia)


def point_of(numbers: Numbers, link: int, site: int) -> Tensor:
    """Where a site, in the plane a tip, is on its link, (..., n)."""
    return numbers.length[..., link : link + 1] if isinstance(numbers, BodyParameters) else numbers.sites[..., site, :]


def size_of(numbers: Numbers, link: int) -> float:
    """How long a link is, m: in space as a rod of its centre of mass and inertia would be, for single numbers."""
    if isinstance(numbers, BodyParameters):
        return numbers.length[link].item()
    own = inertia_of(numbers, link)
    swing = (own.mean / own.mass.clamp_min(SMALLEST)).sqrt().item()
    return 2 * max(own.com.norm().item(), swing)


def _with_row(rows: Tensor, place: int, value: Tensor) -> Tensor:
    """Rows (..., L, r) with another one (..., r) at a place."""
    here = (torch.arange(rows.shape[-2]) == place).unsqueeze(-1)
    return torch.where(here, value.unsqueeze(-2), rows)


def point_moments(d: Tensor) -> Tensor:
    """Moments (..., r) of one kilogram at d (..., n)."""
    if d.shape[-1] == 1:
        return d**2
    x, y, z = d.unbind(-1)
    return torch.stack([y**2 + z**2, x**2 + z**2, x**2 + y**2, -x * y, -x * z, -y * z], -1)
