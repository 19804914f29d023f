"""Charts of a tree's joints of several turns, chosen from the recording: a motion through a pole has no coordinates.

With turns about letters a, b and c one after the other (yaw, pitch, roll of "zyx"), the angles are singular where the
link's axis c lies along the joint's axis a: at a pitch of 90°. Where a motion passes a pitch of ``WIDE``, the joint's
frame is rotated: its axis a is put where the link's axis c, whose directions are d_t, stays farthest from it,

    a = argmin over unit vectors of max_t |a · d_t|,

and zero in the middle of the motion. A ball is the same ball then. A universal joint is another mechanism, of another
twist, and is rotated only where twist has no effect: of a stick on which nothing hangs but balls and other such sticks.

Shapes: T rows, K coordinates.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.models import Body, Link
from invdyn.models.bodies.rotations import LETTERS, UNTURNED, clean

WIDE, STEEP = 60.0, 80.0
"""Pitch, degrees, from which on another chart is looked for, and beyond which none is good."""
AXES = 2000
"""Unit vectors that are tried, evenly over the sphere."""

Paths = Callable[[Body], np.ndarray | None]
"""From a tree to coordinates (T, K) of the recording; None where it tells none."""


def chosen(tree: Body, paths: Paths) -> tuple[Body, list[str]]:
    """The tree in charts that suit the recording, and a sentence for each joint whose frame was rotated."""
    said: list[str] = []
    tried: set[str] = set()
    while (path := paths(tree)) is not None:
        steep = {name: most for name, most in pitches(tree, path).items() if most > WIDE and name not in tried}
        link = next((link for link in tree.links if link.joint.name in steep and _may_turn(tree, link)), None)
        if link is None:
            return tree, said
        tried.add(link.joint.name)
        frame = frame_for(directions(tree, link, path), link.joint.chart)
        rotation = clean(np.array(link.rotation) @ frame)
        rotated = replace(link, rotation=tuple(map(tuple, rotation.tolist())))
        tree = replace(tree, links=tuple(rotated if each is link else each for each in tree.links))
        most = steep[link.joint.name]
        said.append(
            f"{link.joint.name}: its motion comes to a pitch of {most:.0f}° in the body file's frame; "
            "angles and torques are about axes rotated to the middle of the motion (the posterior's constant rotation)"
        )
    return tree, said


def poles(tree: Body, path: np.ndarray) -> list[str]:
    """A sentence for each joint that passes ``STEEP`` along a path (T, K)."""
    return [
        f"{name}: its motion passes a pitch of {STEEP:.0f}° (to {most:.0f}°), where its angles have a pole and "
        "torques are known badly: take a shorter stretch, or give the joint another rotation"
        for name, most in pitches(tree, path).items()
        if most > STEEP
    ]


def pitches(tree: Body, path: np.ndarray) -> dict[str, float]:
    """Largest pitch, degrees from 0 to 90, along a path (T, K), of each joint of two or three turns, by its name."""
    found, place = {}, 0
    for link in tree.links:
        chart, count = link.joint.chart, len(link.joint.motions())
        middle = place + count - len(chart) + 1
        place += count
        if len(chart) > 1 and len(set(chart)) == len(chart):
            found[link.joint.name] = float(np.degrees(np.arcsin(np.abs(np.sin(path[:, middle]))).max()))
    return found


def directions(tree: Body, link: Link, path: np.ndarray) -> np.ndarray:
    """Directions (T, 3) of the link's last axis in the joint's frame, along a path (T, K)."""
    ahead = sum(len(each.joint.motions()) for each in tree.links[: tree.links.index(link)])
    chart, count = link.joint.chart, len(link.joint.motions())
    turns = path[:, ahead + count - len(chart) : ahead + count]
    return Rotation.from_euler(chart.upper(), turns).as_matrix() @ LETTERS[_last(chart)]


def frame_for(directions: np.ndarray, chart: str) -> np.ndarray:
    """The rotation (3, 3) of a joint's frame for `directions` (T, 3) of the link's last axis; see the file's top."""
    golden, place = np.pi * (1 + 5**0.5), np.arange(AXES) + 0.5
    height = 1 - 2 * place / AXES
    ring = np.sqrt(1 - height**2)
    axes = np.stack([ring * np.cos(golden * place), ring * np.sin(golden * place), height], -1)
    pole = axes[np.abs(axes @ directions.T).max(1).argmin()]
    mean = directions.mean(0)
    mean = mean - pole * (mean @ pole)
    mean = mean if np.linalg.norm(mean) > 1e-6 else np.cross(pole, axes[np.abs(axes @ pole).argmin()])
    last, first = _last(chart), chart[0]
    columns = {first: pole, last: mean / np.linalg.norm(mean)}
    (other,) = set("xyz") - set(columns)
    after = {"x": "yz", "y": "zx", "z": "xy"}[other]
    columns[other] = np.cross(columns[after[0]], columns[after[1]])
    return np.stack([columns[letter] for letter in "xyz"], 1)


def _last(chart: str) -> str:
    """The last letter of three, or that which is not among two."""
    return chart[2] if len(chart) == 3 else next(iter(set("xyz") - set(chart)))


def _may_turn(tree: Body, link: Link) -> bool:
    """Whether another frame of its joint is the same body."""
    if link.joint.type in ("ball", "free"):
        return True
    if link.joint.type == "fixed":
        return False
    stick = link.length is not None and link.com is None and link.inertia is None and not link.sites
    plain = link.joint.type == "universal" and _last(link.joint.chart) == "x" and link.joint.reference == UNTURNED
    hanging = [each for each in tree.links if each.parent == link.name]
    return stick and plain and all(each.origin is None and _may_turn(tree, each) for each in hanging)
