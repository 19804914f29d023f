"""A link's inertia (:class:`.bodies.point_mass.Inertia`) in the numbers of a chain or a tree, read and written."""

import torch
from torch import Tensor

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.bodies.point_mass import SMALLEST, Inertia
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.bodies.tree_parameters import TreeParameters
from invdyn.models.effects.base import with_entry

Numbers = BodyParameters | TreeParameters


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
