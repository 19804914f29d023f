"""The numbers of a tree in space as tensors, put together from what its links say; conventions as in :mod:`.body`.

A link that is a stick, of length l along its x axis and mass m, has its com in its middle, and a thin rod's inertia
m l²/12 about y and z, unless it says otherwise. What hangs on it without an origin of its own stands at its tip.
Learned and uncertain lengths then take all of it along.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.inertia import NAMES
from invdyn.models.bodies.link import Link, Vector
from invdyn.models.bodies.scalars import Scalar


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
    links: Sequence[Link],
    parents: Sequence[int],
    gravity: Sequence[float],
    draw: Callable[[Scalar, str], Tensor],
    lengths_first: bool = False,
) -> TreeParameters:
    """The numbers of ``links`` on their ``parents`` (−1 the world), each scalar by ``draw`` of it and its site.

    ``lengths_first``: a link's length is drawn before its mass, as seeds of chains in the plane rely on.
    """

    def drawn(values: Vector, link: Link, word: str, letters: Sequence[str] = "xyz") -> list[Tensor]:
        one = word in ("com", "inertia") and link.along(word)
        return [
            value if isinstance(value, Tensor) else draw(value, f"{link.name}.{word}" + ("" if one else f"_{letter}"))
            for value, letter in zip(values, letters, strict=True)
        ]

    mass, com, inertia, position, sites, lengths = [], [], [], [], [], []
    for link, parent in zip(links, parents, strict=True):
        scalars = {"mass": link.mass, "length": link.length}
        order = sorted(scalars) if lengths_first else list(scalars)
        own = {key: draw(value, f"{link.name}.{key}") for key in order if (value := scalars[key]) is not None}
        mass.append(own["mass"])
        length = own.get("length")
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


def vector_of(link: Link, quantity: str) -> Vector | None:
    """A link's com (3) or inertia (6) as stated, None where it is left out; one number is along x, or about z."""
    value = getattr(link, quantity)
    if value is None or not link.along(quantity):
        return value
    return (value, 0.0, 0.0) if quantity == "com" else (0.0, 0.0, value, 0.0, 0.0, 0.0)


def moments(link: Link, mass: Any, length: Any) -> Sequence[Any]:
    """A link's six moments about its centre of mass, kg·m²: its own, or those of a thin rod of that mass and length."""
    if (given := vector_of(link, "inertia")) is not None:
        return given
    rod = 0.0 if length is None else mass * length**2 / 12
    return (0.0, rod, rod, 0.0, 0.0, 0.0)


def _com(link: Link, length: Any) -> Sequence[Any]:
    if (given := vector_of(link, "com")) is not None:
        return given
    return (0.0, 0.0, 0.0) if length is None else (length / 2, 0.0, 0.0)


def _stacked(scalars: Sequence[Tensor], dim: int = -1) -> Tensor:
    return torch.stack(torch.broadcast_tensors(*scalars), dim)


def _rows(rows: Sequence[Sequence[Tensor]]) -> Tensor:
    return _stacked([_stacked(row) for row in rows], -2)


class Sticks:
    """Those among a tree's ``links``, by their ``parents`` (−1 the world) and the tree's names of sites.

    Of a chain ``in_plane`` numbers are one a link, and its joints' places follow by themselves.
    """

    def __init__(self, links: Sequence[Link], parents: Sequence[int], sites: Sequence[str], in_plane: bool):
        sticks = [link.length is not None for link in links]
        on_stick = [parent >= 0 and sticks[parent] and not in_plane for parent in parents]
        self.in_plane = in_plane
        follows = {
            "com": [stick and link.com is None for stick, link in zip(sticks, links, strict=True)],
            "inertia": [stick and link.inertia is None for stick, link in zip(sticks, links, strict=True)],
            "position": [on and link.origin is None for on, link in zip(on_stick, links, strict=True)],
        }
        self.follows = {key: rows for key, rows in follows.items() if any(rows)}
        self.places = {
            "tip": [0 if link.tip is None else sites.index(link.tip) for link in links],
            "parent": [max(parent, 0) for parent in parents],
        }
        self._on: dict[torch.device, dict[str, Tensor]] = {}

    def completed(self, numbers: Any) -> Any:
        """The numbers with what sticks leave out following their masses and lengths, which a tree's tips show."""
        if not self.follows:
            return numbers
        own = self._masks(numbers.mass.device)
        length = numbers.length if self.in_plane else numbers.sites[..., own["tip"], 0]
        rod = numbers.mass * length**2 / 12
        values = {"com": length / 2, "inertia": rod}
        if not self.in_plane:
            none, none_of_rod = torch.zeros_like(length), torch.zeros_like(rod)
            rows = {
                "com": [length / 2, none, none],
                "inertia": [none_of_rod, rod, rod, none_of_rod, none_of_rod, none_of_rod],
                "position": [length[..., own["parent"]], none, none],
            }
            values = {key: torch.stack(rows[key], -1) for key in self.follows}
        return numbers._replace(
            **{key: torch.where(own[key], values[key], getattr(numbers, key)) for key in self.follows}
        )

    def _masks(self, device: torch.device) -> dict[str, Tensor]:
        """Which numbers or rows (L, 1) follow from lengths, by name; links' tips and parents (L,), 0 for none.

        Kept once computed, as every row needs them.
        """
        if device not in self._on:
            found = {key: torch.tensor(rows, device=device) for key, rows in (self.follows | self.places).items()}
            rows = {} if self.in_plane else {key: found[key].unsqueeze(-1) for key in self.follows}
            self._on[device] = found | rows
        return self._on[device]
