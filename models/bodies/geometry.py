"""Geometry of a tree of links: where it may turn, which sites a picture joins by lines, and where it carries a load.

Links stand with parents before children; ``parents`` has the place of each link's parent among them, −1 for the world.
Sites (S, 3) m are those of all links in their order, each in its own link's frame.
"""

from collections.abc import Sequence

import numpy as np
from torch import Tensor

from invdyn.models.bodies.link import Link
from invdyn.models.bodies.rotations import about


def site_numbers(links: Sequence[Link]) -> list[list[int]]:
    """For each link the numbers of its sites among the S."""
    found: list[list[int]] = []
    first = 0
    for link in links:
        found.append(list(range(first, first + len(link.points))))
        first += len(link.points)
    return found


def turning(links: Sequence[Link], parents: Sequence[int]) -> list[np.ndarray]:
    """For each link, directions in its own frame that its angular velocity may have, (n, 3).

    Each turn further out is set to an angle that is nothing special, so that no two axes are parallel by chance.
    """
    found: list[np.ndarray] = []
    for link, parent in zip(links, parents, strict=True):
        inner = found[parent] if parent >= 0 else np.zeros((0, 3))
        directions = inner @ np.array(link.rotation)
        for place, motion in enumerate(link.joint.motions()):
            if motion.turns:
                directions = directions @ about(motion.axis, 0.7 + place)
                directions = np.concatenate([directions, motion.axis[None]])
        found.append(directions @ np.array(link.joint.reference))
    return found


def skeleton(
    links: Sequence[Link], parents: Sequence[int], sites: Tensor, positions: Tensor, stands: bool
) -> list[tuple[int, int]]:
    """Pairs of sites that a line joins in a picture: each with that, further in, which is next to its link's joint.

    −1 is the base, if the first joint ``stands`` at one place. ``positions`` (L, 3) m are the joints', in the frames of
    the links' parents.
    """
    hubs: list[int | None] = []
    edges: list[tuple[int, int]] = []
    numbers = site_numbers(links)
    for place, parent in enumerate(parents):
        hub = (-1 if stands else None) if parent < 0 else hubs[parent]
        if parent >= 0 and (near := numbers[parent]):
            hub = near[int((sites[near] - positions[place]).norm(dim=-1).argmin())]
        hubs.append(hub)
        edges += [(hub, site) for site in numbers[place] if hub is not None]
    return edges


def hand(links: Sequence[Link], parents: Sequence[int], sites: Tensor) -> tuple[int, int] | None:
    """The last link, or of several that end the tree what they hang on, and its site farthest from its joint.

    None where that is the world, or has no site.
    """
    ends = [k for k in range(len(links)) if k not in parents]
    inwards = [[end] for end in ends]
    for way in inwards:
        while parents[way[-1]] >= 0:
            way.append(parents[way[-1]])
    common = [k for k in inwards[0] if all(k in way for way in inwards)]
    own = site_numbers(links)[common[0]] if common else []
    if not own:
        return None
    return common[0], own[int(sites[own].norm(dim=-1).argmax())]
