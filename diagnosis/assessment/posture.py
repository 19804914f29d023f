"""A body in one posture, as a picture shows it: joints, links and keypoints as points and lines between them.

A chain in the plane has one picture. A body in space has two: from the side, where it is widest, and from the front, a
quarter of a turn on; up is against gravity. With P the points about their middle, and u upwards, the side's x is the
first principal axis of P (E − u uᵀ).

Shapes: N points, K joints, d coordinates.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArticulatedBody, Body, dynamics_for

MARK = "joint of "
"""Before a link's name: the site that is put at its joint."""


@dataclass(frozen=True)
class Posture:
    """A body in a posture.

    Attributes:
        points: (N, d) m.
        lines: between two points each: number of the link, −1 for what stands still, from, to.
        joints: (K,) at which point each is.
        keypoints: name → the point that shows it.
        views: (V, 2, d) each picture's x and y.
    """

    points: np.ndarray
    lines: tuple[tuple[int, int, int], ...]
    joints: tuple[int, ...]
    keypoints: Mapping[str, int] = field(default_factory=dict)
    views: np.ndarray = field(default_factory=lambda: np.eye(2)[None])


def base_of(body: ArticulatedBody) -> np.ndarray:
    """Where the first joint is, (d,) m, if it stands still; else the frame's origin."""
    given = body.described(body.parameters()).get("base")
    return np.zeros(body.dimensions) if given is None else given[1].numpy()


def typical_row(angle: np.ndarray) -> int | None:
    """The row of angles (T, K) that is nearest to their medians; None where all have a gap."""
    good = np.flatnonzero(np.isfinite(angle).all(-1))
    if not good.size:
        return None
    off = np.abs(angle[good] - np.median(angle[good], 0)).sum(-1)
    return int(good[off.argmin()])


def posture(body: ArticulatedBody, angle: np.ndarray | None = None) -> Posture | None:
    """A body at ``angle`` (K,), or where its file has it, a chain slightly bent; None for a kind without links."""
    if not isinstance(body, Body):
        return None
    tree, d = body.in_space(), body.dimensions
    links = [replace(link, sites={**link.sites, MARK + link.name: (0.0, 0.0, 0.0)}) for link in tree.links]
    marked = replace(tree, links=links)
    q = torch.as_tensor(np.array(body.hanging, float) + (0.4 if body.is_chain else 0.0) if angle is None else angle)
    sites = dynamics_for(marked).keypoints(q, marked.parameters()).numpy()
    at = dict(zip(marked.keypoint_names, sites, strict=True))
    near = FIXED.negligible * max(float(np.ptp(sites, 0).max()), 1e-12)
    points: list[np.ndarray] = []

    def number(place: np.ndarray) -> int:
        for n, known in enumerate(points):
            if np.linalg.norm(known - place) <= near:
                return n
        points.append(place)
        return len(points) - 1

    hubs = [number(at[MARK + link.name]) for link in body.links]
    keypoints = {name: number(at[name]) for name in body.keypoint_names}
    lines = [(parent, number(np.zeros(3)) if parent < 0 else hubs[parent], hubs[k])
             for k, parent in enumerate(body.parents)
             if parent >= 0 or (d == 3 and body.links[k].joint.type != "free")]  # fmt: skip
    lines += [(k, hubs[k], keypoints[name]) for k, link in enumerate(body.links) for name in link.points]
    owners = [hubs[body.links.index(link)] for link, _ in body.motions()]
    drawn = tuple(dict.fromkeys(line for line in lines if line[1] != line[2]))
    views = np.eye(2)[None] if d == 2 else _views(np.array(points), np.array(body.gravity))
    return Posture(np.array(points)[:, :d], drawn, tuple(owners), keypoints, views)


def _views(points: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """The side's and the front's x and y, (2, 2, 3)."""
    weight = np.linalg.norm(gravity)
    up = -gravity / weight if weight > 0 else np.array([0.0, 0.0, 1.0])
    level = np.eye(3) - np.outer(up, up)
    _, _, axes = np.linalg.svd((points - points.mean(0)) @ level)
    across = level @ axes[0]
    if np.linalg.norm(across) < 0.5:  # all on one plumb line
        across = level @ np.eye(3)[np.abs(up).argmin()]
    across = across / np.linalg.norm(across)
    across = across * (1.0 if across[np.abs(across).argmax()] > 0 else -1.0)
    return np.array([[across, up], [np.cross(up, across), up]])
