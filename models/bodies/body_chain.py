"""From rigid parts in space to the tables of a planar chain: what MJCF and URDF have in common.

Parts stand in the file's reference pose, in world coordinates. With the hinges' common axis n, what moves together is
one link, of

    length    from its hinge to the next one, in the plane across n; the last one's to its tip
    mass      Σ m,        com = that of all its parts, along the line from hinge to tip
    inertia   Σ nᵀ I n + m d² about the centre of mass, d across n

No other moment is looked at: a tensor may break the triangle inequality in directions that the plane never uses. The
plane is (x, z) for hinges about y, (x, y) about z, (y, z) about x: the recording's x and y. Angles need no conversion:
ours are Denavit–Hartenberg, seen in the picture, whatever pose the file calls zero. Where a robot's own angles are
wanted, q = ±(θ − θ₀), with θ₀ the angle of the link in the file's reference pose, and − for a hinge about the axis that
points away from the viewer; torques then change their sign too, and a warning says so.

Of the last link's marked points the one farthest from its hinge is the tip; else the farthest frame of what is fixed to
it; else the far end of a shape. What a file has and a rigid body lacks is named in a warning: a diagnosis may find it.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from invdyn.models.bodies.joint_parts import NOTHING, JointParts
from invdyn.models.bodies.scalars import BodyError

PLANES = {"x": ("y", "z"), "y": ("x", "z"), "z": ("x", "y")}
ASIDE = 1e-3
"""Of a length: what is nearer to a line is on it."""


@dataclass(frozen=True)
class Hinge:
    """A hinge's name, a point on its axis (3,) m, and the axis (3,) of length 1."""

    name: str
    anchor: np.ndarray
    axis: np.ndarray


@dataclass(frozen=True)
class Part:
    """A rigid part: mass kg, com (3,) m, inertia (3, 3) kg·m² about it, origin of its frame (3,) m, all in the world.

    `parent` is the number of the part that it hangs on, an earlier one, or −1 for the world; `hinge` None where it is
    fixed to it. `marks` are named points (3,), `ends` the ends of its shapes.
    """

    name: str
    parent: int
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    origin: np.ndarray
    hinge: Hinge | None = None
    marks: Sequence[tuple[str, np.ndarray]] = ()
    ends: Sequence[np.ndarray] = ()


def tables(
    parts: Sequence[Part],
    gravity: np.ndarray,
    left_out: Sequence[str],
    where: str,
    joints: Mapping[str, JointParts] | None = None,
) -> dict:
    """Name, gravity, base and links, as :func:`.body_toml.read` returns them, of parts and the gravity (3,), m/s².

    `joints` maps hinges to what they have besides, in the file's own angles. Warns (UserWarning) of `left_out`, of
    centres of mass aside, and of hinges that turn clockwise. Raises `BodyError`, which begins with `where`, for what is
    no planar chain of hinges, and for a link without length or mass.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a link's numbers are checked when it is made
        return _tables(parts, gravity, left_out, where, joints or {})


def _tables(
    parts: Sequence[Part], gravity: np.ndarray, left_out: Sequence[str], where: str, joints: Mapping[str, JointParts]
) -> dict:
    groups = _groups(parts, where)
    hinges = [hinge for group in groups if (hinge := group[0].hinge) is not None]
    axis, signs = _axis(hinges, where)
    u, v, normal = _frame(axis)
    plane = np.stack([u, v])
    anchors = [plane @ hinge.anchor for hinge in hinges]
    tip_name, tip = _tip(groups[-1], plane, where)
    ends = [*anchors[1:], tip]
    tips = [*(hinge.name for hinge in hinges[1:]), tip_name]
    links, notes, before = [], [], 0.0
    for group, hinge, sign, shown, start, end in zip(groups, hinges, signs, tips, anchors, ends, strict=True):
        name = group[0].name
        length = float(np.linalg.norm(end - start))
        if not length > 0:
            raise BodyError(f"{where}: link '{name}' has no length: its hinge and its end are at one place")
        mass, com, inertia = _inertial(group, plane, normal, where)
        along = (end - start) / length
        aside, reach = (float(x) for x in (com - start) @ np.array([[-along[1], along[0]], along]).T)
        if abs(aside) > ASIDE * length:
            notes.append(f"that the centre of mass of {name} is {aside:.3g} m beside the line of its joints")
        # about the hinge the inertia stays what it is
        given = {"length": length, "mass": mass, "com": reach, "inertia": inertia + mass * aside * aside}
        if not np.isfinite(list(given.values())).all():
            raise BodyError(f"{where}: link '{name}': its length or inertia is no finite number; are the units SI?")
        links.append({"name": name, "joint": hinge.name, "tip": shown, **given})
        heading = math.atan2(along[1], along[0])
        zero = math.remainder(heading - before, math.tau)
        parts_here = joints.get(hinge.name, NOTHING).turned(float(sign * normal[axis]), zero)
        if parts_here != NOTHING:
            links[-1]["parts"] = parts_here
        before = heading
    if found := [*notes, *left_out]:
        warnings.warn(f"{where}: a rigid body leaves out {'; '.join(found)}", UserWarning, stacklevel=5)
    if against := [hinge.name for hinge, sign in zip(hinges, signs, strict=True) if sign * normal[axis] < 0]:
        warnings.warn(
            f"{where}: {', '.join(against)} turn{'s' * (len(against) == 1)} clockwise in the plane of the picture; "
            "a recording's torques and angles are counter-clockwise positive",
            UserWarning,
            stacklevel=5,
        )
    return {
        "name": Path(where).stem,
        "gravity": [float(g) for g in plane @ gravity],
        "base": [float(b) for b in anchors[0]],
        "links": links,
    }


def listed(words: str, names: Sequence[str]) -> list[str]:
    """One entry of what is left out, "words (names)"; none without names. A long list is cut."""
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    return [f"{words} ({shown})"] if names else []


def _groups(parts: Sequence[Part], where: str) -> list[list[Part]]:
    """What moves together, from the base outwards; the first of each group has the hinge."""
    group_of: list[int] = []
    groups: list[list[Part]] = []
    for part in parts:
        parent = group_of[part.parent] if part.parent >= 0 else -1
        if part.hinge is None:
            group_of.append(parent)
            if parent >= 0:
                groups[parent].append(part)
            continue
        if parent != len(groups) - 1:
            raise BodyError(f"{where}: expected a chain, but it branches at body '{part.name}'")
        group_of.append(len(groups))
        groups.append([part])
    if not groups:
        raise BodyError(f"{where}: expected a chain of hinges, got a body without joints")
    return groups


def _axis(hinges: Sequence[Hinge], where: str) -> tuple[int, np.ndarray]:
    """The number of the common axis (0 x, 1 y, 2 z), and along or against it for each hinge."""
    axes = np.array([hinge.axis for hinge in hinges])
    nearest = np.abs(axes).argmax(1)
    # most of them say which: of a turning base with an arm on it, the base is the odd one
    counts = np.bincount(nearest, minlength=3)
    axis = int(nearest[0] if counts[nearest[0]] == counts.max() else counts.argmax())
    for hinge, own in zip(hinges, axes, strict=True):
        if not abs(own[axis]) >= 1 - 1e-5:
            raise BodyError(
                f"{where}: expected all hinges about one of the axes x, y and z, so that the chain moves in a plane; "
                f"joint '{hinge.name}' turns about ({', '.join(f'{a:.3g}' for a in own)}); "
                "if it stands still in the recording, make it a fixed one"
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
    mass = np.array([part.mass for part in group])
    total = float(mass.sum())
    if not total > 0:
        raise BodyError(
            f"{where}: link '{group[0].name}' moves, but neither it nor what is fixed to it has a mass; "
            "give it an inertial element"
        )
    com = np.array([part.com for part in group]) @ plane.T
    centre = mass @ com / total
    own = sum(normal @ part.inertia @ normal for part in group)
    return total, centre, float(own + mass @ ((com - centre) ** 2).sum(-1))


def _tip(group: Sequence[Part], plane: np.ndarray, where: str) -> tuple[str, np.ndarray]:
    """Name and place (2,) of the end of the last link."""
    name, hinge = group[0].name, group[0].hinge
    assert hinge is not None  # a group begins with one
    anchor = hinge.anchor
    points = [mark for part in group for mark in part.marks]
    points = points or [(part.name, part.origin) for part in group[1:]]
    points = points or [(f"{name}_tip", end) for part in group for end in part.ends]
    far = max(points, key=lambda point: np.linalg.norm(plane @ (point[1] - anchor)), default=None)
    if far is None or np.linalg.norm(plane @ (far[1] - anchor)) == 0:
        raise BodyError(
            f"{where}: nothing says where the last link '{name}' ends: give it a site (MJCF) or a fixed link (URDF) "
            "at its tip"
        )
    return far[0], plane @ far[1]
