"""From rigid parts in space (`parts.py`) to the tables of a planar chain.

With the hinges' common axis n, what moves together is one link, of

    length    from its hinge to the next one, in the plane across n; the last one's to its tip
    mass      Σ m,        com = that of all its parts, along the line from hinge to tip
    inertia   Σ nᵀ I n + m d² about the centre of mass, d across n

No other moment is looked at: a tensor may break the triangle inequality in directions that the plane never uses. The
plane is (x, z) for hinges about y, (x, y) about z, (y, z) about x: the recording's x and y. Angles need no conversion:
ours are Denavit–Hartenberg, seen in the picture, in any zero pose of the file. A robot's own
angles are q = ±(θ − θ₀), where they are wanted. θ₀ is the angle of the link where the file's own angles are 0. The sign
is − for a hinge about the axis that points away from the viewer; torques then change sign too, and a warning says so.

Of the last link's marked points the one farthest from its hinge is the tip; else the farthest frame of what is fixed to
it; else the far end of a shape; else the centre of mass, as a single pendulum's file may mark no end. What a file has
and a rigid body lacks is named in a warning: a diagnosis may find it.
"""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invdyn.models.bodies import parts as rigid
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.models.bodies.parts import PARALLEL, Part, PartJoint, Robot, check_finite
from invdyn.models.bodies.scalars import BodyError

PLANES = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
MAX_OFF_LINE = 1e-3
"""Of a length: what is nearer to a line is on it."""


def tables(robot: Robot, where: str) -> dict:
    """Name, gravity, base and links, as :func:`.body_toml.of` returns them, of a robot.

    Warns (UserWarning) of what is left out, of centres of mass off the line, and of hinges that turn clockwise. Raises
    `BodyError`, which begins with `where`, for what is no planar chain of hinges, and a link without length or mass.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a link's numbers are checked when it is made
        found, off, more, against = _tables(robot, where)
    if left := [*off, *more, *robot.left_out]:
        warnings.warn(f"{where}: a rigid body leaves out {'; '.join(left)}", UserWarning, stacklevel=4)
    if against:
        warnings.warn(
            f"{where}: {', '.join(against)} turn{'s' * (len(against) == 1)} clockwise in the plane of the picture; "
            "a recording's torques and angles are counter-clockwise positive",
            UserWarning,
            stacklevel=4,
        )
    return found


def _tables(robot: Robot, where: str) -> tuple[dict, list[str], list[str], list[str]]:
    """The tables, what is left out of centres of mass and besides, and names of hinges that turn clockwise."""
    groups, hinges = _chain(robot.parts, where)
    axis, signs = _axis(hinges, where)
    u, v, normal = _frame(axis)
    plane = np.stack([u, v])
    anchors = [plane @ hinge.anchor for hinge in hinges]
    tip_name, tip, assumed = _tip(groups[-1], plane, where)
    ends = [*anchors[1:], tip]
    tips = [*(_shown(group, hinge, plane) for group, hinge in zip(groups, hinges[1:], strict=False)), tip_name]
    links, notes, before = [], [], 0.0
    for group, hinge, sign, shown, start, end in zip(groups, hinges, signs, tips, anchors, ends, strict=True):
        name = group[0].name
        length = float(np.linalg.norm(end - start))
        if not length > 0:
            raise BodyError(f"{where}: link '{name}' has no length: its hinge and its end are at one place")
        mass, com, inertia = _inertial(group, plane, normal, where)
        along = (end - start) / length
        offset, reach = (float(x) for x in (com - start) @ np.array([[-along[1], along[0]], along]).T)
        if abs(offset) > MAX_OFF_LINE * length:
            notes.append(f"that the centre of mass of {name} is {abs(offset):.3g} m off the line of its joints")
        # about the hinge the inertia stays what it is
        given = {"length": length, "mass": mass, "com": reach, "inertia": inertia + mass * offset * offset}
        check_finite(list(given.values()), f"{where}: link '{name}'")
        links.append({"name": name, "joint": hinge.name, "tip": shown, **given})
        heading = math.atan2(along[1], along[0])
        zero = math.remainder(heading - before, math.tau)
        parts_here = robot.joint_parts.get(hinge.name, NOTHING).turned(float(sign * normal[axis]), zero)
        if parts_here != NOTHING:
            links[-1]["parts"] = parts_here
        before = heading
    against = [hinge.name for hinge, sign in zip(hinges, signs, strict=True) if sign * normal[axis] < 0]
    found = {
        "name": Path(where).stem,
        "gravity": [float(g) for g in plane @ robot.gravity],
        "base": [float(b) for b in anchors[0]],
        "links": links,
    }
    return found, notes, assumed, against


def masses_off_line(robot: Robot, where: str) -> list[str]:
    """What a chain in the plane leaves out of centres of mass, in words, link by link. Raises as `tables` does."""
    return _tables(robot, where)[1]


def _chain(parts: Sequence[Part], where: str) -> tuple[list[list[Part]], list[PartJoint]]:
    """What moves together, from the base outwards; the first of each group has the hinge."""
    for part in parts:
        if strange := [joint for joint in part.joints if joint.type != "hinge"]:
            raise BodyError(
                f"{where}: expected hinges alone, joint '{strange[0].name}' is of type {strange[0].type}; "
                "a body of 3 dimensions takes it"
            )
        if len(part.joints) > 1:
            raise BodyError(f"{where}: expected one hinge a body, '{part.name}' has {len(part.joints)}")
    groups, parents = rigid.groups(parts)
    for place, parent in enumerate(parents):
        if parent != place - 1:
            raise BodyError(f"{where}: expected a chain, but it branches at body '{groups[place][0].name}'")
    if not groups:
        raise BodyError(f"{where}: expected a chain of hinges, got a body without joints")
    return groups, [group[0].joints[0] for group in groups]


def _axis(hinges: Sequence[PartJoint], where: str) -> tuple[int, np.ndarray]:
    """The number of the common axis (0 x, 1 y, 2 z), and along or against it for each hinge."""
    axes = np.array([hinge.axis for hinge in hinges])
    nearest = np.abs(axes).argmax(1)
    # most of them say which: of a turning base with an arm on it, the base is the odd one
    counts = np.bincount(nearest, minlength=3)
    axis = int(nearest[0] if counts[nearest[0]] == counts.max() else counts.argmax())
    for hinge, own in zip(hinges, axes, strict=True):
        if not abs(own[axis]) >= PARALLEL:
            raise BodyError(
                f"{where}: expected all hinges about one axis, x, y or z; "
                f"joint '{hinge.name}' turns about ({', '.join(f'{a:.3g}' for a in own)}): "
                "make it a fixed one if it stands still in the recording"
            )
    return axis, np.sign(axes[:, axis])


def _frame(axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plane's x and y, and the axis towards the viewer."""
    u, v = (np.eye(3)["xyz".index(letter)] for letter in PLANES["xyz"[axis]])
    return u, v, np.cross(u, v)


def _inertial(
    group: Sequence[Part], plane: np.ndarray, normal: np.ndarray, where: str
) -> tuple[float, np.ndarray, float]:
    """Mass, centre of mass (2,) and moment about it of parts that move together."""
    mass, com, inertia = rigid.lumped(group)
    if not mass > 0:
        raise BodyError(
            f"{where}: link '{group[0].name}' moves, but neither it nor what is fixed to it has a mass; "
            "give it an inertial element"
        )
    return mass, plane @ com, float(normal @ inertia @ normal)


def _shown(group: Sequence[Part], hinge: PartJoint, plane: np.ndarray) -> str:
    """What the next hinge's place is called: as a marked point of the link there, or as the hinge."""
    there = plane @ hinge.anchor
    reach = np.linalg.norm(there - plane @ group[0].joints[0].anchor)
    names = [
        name for part in group for name, at in part.marks if np.linalg.norm(plane @ at - there) <= MAX_OFF_LINE * reach
    ]
    return hinge.name if not names or hinge.name in names else names[0]


def _tip(group: Sequence[Part], plane: np.ndarray, where: str) -> tuple[str, np.ndarray, list[str]]:
    """Name and place (2,) of the end of the last link, and what is left out where nothing marks it."""
    name, anchor = group[0].name, group[0].joints[0].anchor
    points = [mark for part in group for mark in part.marks]
    points = points or [(part.name, part.origin) for part in group[1:]]
    points = points or [(f"{name}_tip", end) for part in group for end in part.ends]
    left = [] if points else [f"where {name} ends: its centre of mass stands for it (a camera needs a site at its tip)"]
    points = points or [(f"{name}_com", rigid.lumped(group)[1])]
    far = max(points, key=lambda point: np.linalg.norm(plane @ (point[1] - anchor)), default=None)
    if far is None or np.linalg.norm(plane @ (far[1] - anchor)) == 0:
        raise BodyError(
            f"{where}: nothing says where the last link '{name}' ends: give it a site (MJCF) or a fixed link (URDF) "
            "at its tip"
        )
    return far[0], plane @ far[1], left
