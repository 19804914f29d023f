"""Links of a tree that are sticks along their x axes: what they leave out follows their lengths and masses.

A stick of length l and mass m, whose tip shows l, has its com in its middle, and a thin rod's inertia m l²/12 about y
and z; what hangs on it without an origin of its own stands at its tip. Learned and uncertain lengths then take all of
it along. Shapes: L links, numbers (..., L, 3 or 6).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from invdyn.models.bodies.link import Link
from invdyn.models.bodies.tree_parameters import TreeParameters


class Sticks:
    """Those among a tree's ``links``, by their ``parents`` (−1 the world) and the tree's names of sites."""

    def __init__(self, links: Sequence[Link], parents: Sequence[int], sites: Sequence[str]):
        sticks = [link.length is not None for link in links]
        on_stick = [parent >= 0 and sticks[parent] for parent in parents]
        self.any = any(sticks)
        self.follows = {
            "com": [stick and link.com is None for stick, link in zip(sticks, links, strict=True)],
            "inertia": [stick and link.inertia is None for stick, link in zip(sticks, links, strict=True)],
            "position": [on and link.origin is None for on, link in zip(on_stick, links, strict=True)],
        }
        self.places = {
            "tip": [0 if link.tip is None else sites.index(link.tip) for link in links],
            "parent": [max(parent, 0) for parent in parents],
        }
        self._on: dict[torch.device, dict[str, Tensor]] = {}

    def completed(self, numbers: TreeParameters) -> TreeParameters:
        """The numbers with what sticks leave out following their lengths, which their tips show, and masses."""
        if not self.any:
            return numbers
        own = self._masks(numbers.mass.device)
        length = numbers.sites[..., own["tip"], 0]
        none, rod = torch.zeros_like(length), numbers.mass * length**2 / 12
        none_of_rod = torch.zeros_like(rod)
        stretch = length[..., own["parent"]]
        follows = {
            "com": [length / 2, none, none],
            "inertia": [none_of_rod, rod, rod, none_of_rod, none_of_rod, none_of_rod],
            "position": [stretch, none, none],
        }
        return numbers._replace(
            **{
                key: torch.where(own[key], torch.stack(each, -1), getattr(numbers, key))
                for key, each in follows.items()
            }
        )

    def _masks(self, device: torch.device) -> dict[str, Tensor]:
        """Which rows of com, inertia and position (L, 1) follow from lengths; links' tips and parents (L,), 0 for none.

        Kept once computed, as every row needs them.
        """
        if device not in self._on:
            self._on[device] = {
                **{key: torch.tensor(rows, device=device).unsqueeze(-1) for key, rows in self.follows.items()},
                **{key: torch.tensor(rows, device=device) for key, rows in self.places.items()},
            }
        return self._on[device]
