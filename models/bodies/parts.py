"""Rigid parts in space: what MJCF and URDF come to, before a chain in the plane or a tree is made of them.

Parts stand in one pose, in world coordinates: that in which all of the file's hinges and slides are at 0. A part moves
against its parent by its joints, one after the other, each about, or along, an axis of its own; without one it is
fixed to it, and both move together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.bodies.scalars import BodyError

PARALLEL = 1 - 1e-5
"""Cosine from which on an axis is one of x, y and z."""


@dataclass(frozen=True)
class PartJoint:
    """A joint's name, a point on its axis (3,) m, the axis (3,) of length 1, and type: hinge, slide, ball or free.

    A ball has no axis, a free joint neither axis nor point: theirs are any.
    """

    name: str
    anchor: np.ndarray
    axis: np.ndarray
    type: str = "hinge"


@dataclass(frozen=True)
class Part:
    """A rigid part: mass kg, com (3,) m, inertia (3, 3) kg·m² about it; all in the world.

    `origin` (3,) m and `turn` (3, 3) place its frame. `parent` is the number of the part that it hangs on, an earlier
    one, or −1 for the world. `marks` are named points (3,), `ends` the ends of its shapes.
    """

    name: str
    parent: int
    mass: float
    com: np.ndarray
    inertia: np.ndarray
    origin: np.ndarray
    turn: np.ndarray
    joints: Sequence[PartJoint] = ()
    marks: Sequence[tuple[str, np.ndarray]] = ()
    ends: Sequence[np.ndarray] = ()


@dataclass(frozen=True)
class Robot:
    """A file's parts, and gravity (3,) m/s².

    `joint_parts` is what its joints have besides, in the file's own angles, by name; `left_out` are words for what it
    has and links with such joints lack. `angles_are_free`: no recording comes in the file's own angles.
    """

    parts: Sequence[Part]
    gravity: np.ndarray
    left_out: Sequence[str] = ()
    joint_parts: Mapping[str, JointParts] = field(default_factory=dict)
    angles_are_free: bool = True


def groups(parts: Sequence[Part]) -> tuple[list[list[Part]], list[int]]:
    """What moves together, the part with the joint first; and the number of the group each hangs on, −1 for the world.

    What cannot move at all is in none.
    """
    group_of: list[int] = []
    found: list[list[Part]] = []
    parents: list[int] = []
    for part in parts:
        above = group_of[part.parent] if part.parent >= 0 else -1
        if part.joints:
            parents.append(above)
            group_of.append(len(found))
            found.append([part])
        else:
            group_of.append(above)
            if above >= 0:
                found[above].append(part)
    return found, parents


def lumped(group: Sequence[Part]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it of parts that move together, in the world.

    Without a mass it is at the first one's origin.
    """
    mass = np.array([part.mass for part in group])
    total = float(mass.sum())
    places = np.array([part.com for part in group])
    centre = mass @ places / total if total > 0 else group[0].origin
    off = places - centre
    steiner = (mass * (off**2).sum(-1)).sum() * np.eye(3) - (mass * off.T) @ off
    return total, centre, np.sum([part.inertia for part in group], axis=0) + steiner


def is_planar_chain(parts: Sequence[Part]) -> bool:
    """Whether they are a chain of hinges about one of the axes x, y and z, without a branch."""
    moving, parents = groups(parts)
    joints = [joint for group in moving for joint in group[0].joints]
    if not joints or len(joints) > len(moving) or any(joint.type != "hinge" for joint in joints):
        return False
    along = np.abs([joint.axis for joint in joints]) >= PARALLEL
    return parents == list(range(-1, len(parents) - 1)) and bool(along.all(0).any())


def listed(words: str, names: Sequence[str]) -> list[str]:
    """One entry of what is left out, "words (names)"; none without names. A long list is cut."""
    shown = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
    return [f"{words} ({shown})"] if names else []


def check_finite(values: object, where: str) -> None:
    """Raise `BodyError` unless all numbers of a link are finite."""
    if not np.isfinite(values).all():  # type: ignore[call-overload]
        raise BodyError(f"{where}: its length or inertia is no finite number; are the units SI?")
