"""From rigid parts in space (`parts.py`) to the tables of a tree.

What moves together is one link, called as its first part. With the pose (R, o) of that part's frame, and p the anchor
of the last of its joints, the link's frame has the part's axes and its origin at p, where the coordinates are the
file's own, hinges and slides at 0:

    rotation   R_parentᵀ R        origin   R_parentᵀ (p − p_parent)        axis   Rᵀ n
    com        Rᵀ (c − p)         inertia  Rᵀ I R,   c and I of all its parts together

Of several joints of one part all but the last have massless links of their own. Sites are the file's named points
(MJCF's sites); in a file without them, the frames of its parts by their names: URDF names points in no other way.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invdyn.models.bodies.inertia import six
from invdyn.models.bodies.joints import WORLD
from invdyn.models.bodies.parts import Part, PartJoint, Robot, check_finite, groups, lumped
from invdyn.models.bodies.scalars import BodyError

RIGHT_ANGLE = 2e-11
"""Of a rotation's entry: 1.57079632679, as files print π/2, is that near to it. Exact zeros make dynamics short."""
Frame = tuple[np.ndarray, np.ndarray]
"""Axes, as columns (3, 3), and origin (3,) in the world."""
WORLD_FRAME: Frame = (np.eye(3), np.zeros(3))
DUST = 1e-13
"""Of the largest number (of a moment of inertia: of that about the joint, too): what rounding leaves of 0."""


def tables(robot: Robot, where: str) -> dict:
    """Name, gravity and links, as :func:`.body_toml.of` returns them, of a robot.

    Warns (UserWarning) of what is left out. Raises `BodyError`, which begins with `where`, for parts that do not move.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a link's numbers are checked when it is made
        found = _links(robot, where)
    if robot.left_out:
        warnings.warn(f"{where}: rigid links leave out {'; '.join(robot.left_out)}", UserWarning, stacklevel=4)
    return {"name": Path(where).stem, "gravity": robot.gravity.tolist(), "links": found}


def _links(robot: Robot, where: str) -> list[dict]:
    moving, parents = groups(robot.parts)
    if not moving:
        raise BodyError(f"{where}: expected a body with joints, got one without")
    named = any(part.marks for part in robot.parts)
    frames: list[tuple[np.ndarray, np.ndarray]] = []  # of each group's link: axes and origin
    links: list[dict] = []
    for group, parent in zip(moving, parents, strict=True):
        first = group[0]
        hangs_on, above = (WORLD, WORLD_FRAME) if parent < 0 else (moving[parent][0].name, frames[parent])
        for joint in first.joints:
            is_last = joint is first.joints[-1]
            own = first.turn, first.origin if joint.type == "slide" else joint.anchor
            link = {"name": first.name if is_last else f"{first.name} after {joint.name}", "parent": hangs_on}
            links.append(link | _placed(joint, own, above) | _besides(robot, joint))
            hangs_on, above = link["name"], own
        links[-1] |= _inertial(group, above, f"{where}: link '{first.name}'") | {"sites": _sites(group, above, named)}
        frames.append(above)
    return links


def _besides(robot: Robot, joint: PartJoint) -> dict:
    """A joint's parts, in the file's own coordinate, which is the tree's."""
    parts = robot.joint_parts.get(joint.name)
    return {} if parts is None else {"parts": parts}


def _placed(joint: PartJoint, own: Frame, above: Frame) -> dict:
    """A joint, with its frame's place in the link above."""
    (turn, origin), (outer, start) = own, above
    moves = {"axis": _unit(turn.T @ joint.axis)} if joint.type in ("hinge", "slide") else {}
    rotation = _snapped(outer.T @ turn, RIGHT_ANGLE)
    return {
        "joint": {"name": joint.name, "type": joint.type, **moves},
        "rotation": tuple(map(tuple, rotation.tolist())),
        "origin": _dusted(outer.T @ (origin - start)),
    }


def _inertial(group: Sequence[Part], frame: Frame, where: str) -> dict:
    turn, origin = frame
    mass, com, inertia = lumped(group)
    reach = turn.T @ (com - origin)
    moments = _dusted(six(turn.T @ inertia @ turn), mass * float(reach @ reach))
    check_finite([mass, *reach, *moments], where)
    return {"mass": mass, "com": _dusted(reach), "inertia": moments}


def _sites(group: Sequence[Part], frame: Frame, named: bool) -> dict:
    turn, origin = frame
    points = [mark for part in group for mark in part.marks] if named else [(part.name, part.origin) for part in group]
    return {name: _dusted(turn.T @ (point - origin)) for name, point in points}


def _unit(axis: np.ndarray) -> tuple[float, ...]:
    axis = _snapped(axis, RIGHT_ANGLE)
    return tuple((axis / np.linalg.norm(axis)).tolist())


def _snapped(values: np.ndarray, near: float) -> np.ndarray:
    whole = np.round(values)
    return np.where(np.abs(values - whole) < near, whole, values) + 0.0


def _dusted(values: np.ndarray, least: float = 0.0) -> list[float]:
    return np.where(np.abs(values) < DUST * np.abs(values).max(initial=least), 0.0, values).tolist()
