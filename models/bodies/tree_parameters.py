"""The numbers of a tree in space as tensors, put together from what its links say; conventions as in :mod:`.tree`."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.inertia import NAMES
from invdyn.models.bodies.scalars import Scalar
from invdyn.models.bodies.spatial_link import SpatialLink, Vector


class TreeParameters(NamedTuple):
    """The numbers of a tree of L links and S sites as tensors; leading dimensions are many parameter sets.

    `mass` (..., L), `com` (..., L, 3), `inertia` (..., L, 6), joints' `position` (..., L, 3) and `rotation`
    (..., L, 3, 3) in the parents' frames, `sites` (..., S, 3), `gravity` (..., 3). Units at the top of this file.
    """

    mass: Tensor
    com: Tensor
    inertia: Tensor
    position: Tensor
    rotation: Tensor
    sites: Tensor
    gravity: Tensor

    def to(self, *args: Any, **kwargs: Any) -> "TreeParameters":
        """Return them with `Tensor.to(*args, **kwargs)` applied to every tensor."""
        return TreeParameters(*(value.to(*args, **kwargs) for value in self))


def assembled(
    links: Sequence[SpatialLink],
    parents: Sequence[int],
    gravity: Sequence[float],
    draw: Callable[[Scalar, str], Tensor],
) -> TreeParameters:
    """The numbers of ``links`` on their ``parents`` (−1 the world), each scalar by ``draw`` of it and its site."""

    def drawn(values: Vector, link: SpatialLink, word: str, letters: Sequence[str] = "xyz") -> list[Tensor]:
        return [
            value if isinstance(value, Tensor) else draw(value, f"{link.name}.{word}_{letter}")
            for value, letter in zip(values, letters, strict=True)
        ]

    mass, com, inertia, position, sites, lengths = [], [], [], [], [], []
    for link, parent in zip(links, parents, strict=True):
        mass.append(draw(link.mass, f"{link.name}.mass"))
        length = None if link.length is None else draw(link.length, f"{link.name}.length")
        lengths.append(length)
        stretch = 0.0 if parent < 0 or lengths[parent] is None else lengths[parent]
        com.append(drawn(_com(link, length), link, "com"))
        inertia.append(drawn(moments(link, mass[-1], length), link, "inertia", NAMES))
        position.append(drawn((stretch, 0.0, 0.0) if link.origin is None else link.origin, link, "origin"))
        sites += [drawn((length, 0.0, 0.0) if at is None else at, link, name) for name, at in link.points.items()]
    like: dict[str, Any] = {"dtype": mass[0].dtype, "device": mass[0].device}
    return TreeParameters(
        mass=_stacked(mass),
        com=_rows(com),
        inertia=_rows(inertia),
        position=_rows(position),
        rotation=torch.tensor([link.rotation for link in links], **like),
        sites=_rows(sites) if sites else torch.zeros(0, 3, **like),
        gravity=torch.tensor(gravity, **like),
    )


def moments(link: SpatialLink, mass: Any, length: Any) -> Sequence[Any]:
    """A link's six moments about its centre of mass, kg·m²: its own, or those of a thin rod of that mass and length."""
    if link.inertia is not None:
        return link.inertia
    rod = 0.0 if length is None else mass * length**2 / 12
    return (0.0, rod, rod, 0.0, 0.0, 0.0)


def _com(link: SpatialLink, length: Any) -> Sequence[Any]:
    if link.com is not None:
        return link.com
    return (0.0, 0.0, 0.0) if length is None else (length / 2, 0.0, 0.0)


def _stacked(scalars: Sequence[Tensor], dim: int = -1) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*scalars), dim)


def _rows(rows: Sequence[Sequence[Tensor]]) -> Tensor:
    return _stacked([_stacked(row) for row in rows], -2)
