"""A body as MJCF, for MuJoCo and programs that read its files.

Bodies, joints, sites and inertials have the names of links, coordinates and sites. A joint of several coordinates
becomes several joints of one body, in the order in which they act. So coordinates and torques mean the same on both
sides.
All is written at coordinates 0. Inertials come as principal moments and the quaternion (w, x, y, z) of their axes.

MuJoCo wants of all that moves a mass and moments above 1e-15, and moments that a rigid body can have. A massless link
with one child becomes more joints of the child. A moment of 0 becomes 2e-15 kg·m². A link that turns about one
direction alone may have a tensor that is no rigid body's: a planar body's says the moment about z alone. Then the
moment about that direction stands for all three. Capsules show the links in a viewer; they weigh nothing and touch
nothing.
"""

import warnings
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.geometry import turning
from invdyn.models.bodies.inertia import tensor
from invdyn.models.bodies.joint_parts import NOTHING, JointParts, Motor
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.bodies.whole_file import write_whole

MIN_INERTIAL = 2e-15
"""kg·m², kg: what MuJoCo takes for something."""
ROUNDING = 1e-12
"""Of the largest moment: by so much rounding may break the triangle inequality."""
THIN = 0.03
"""Radius of a capsule, of its length."""


class _Pose(NamedTuple):
    """Axes, as columns (3, 3), and origin (3,) in the world, at coordinates 0."""

    axes: np.ndarray
    origin: np.ndarray


WORLD_POSE = _Pose(np.eye(3), np.zeros(3))


class _Moves(NamedTuple):
    """A coordinate: name, whether it turns, its axis (3,) and a point on that (3,) in the world, at coordinates 0.

    And what else its joint has.
    """

    name: str
    turns: bool
    axis: np.ndarray
    point: np.ndarray
    parts: JointParts | None


def write_mjcf(body: Body, path: str | Path) -> None:
    """Write a body as MJCF: a planar one in the plane z = 0, its hinges about z.

    Warns (UserWarning) of what MJCF cannot say: priors, learned scalars. Raises `BodyError` for a
    massless link that moves with several children or sites of its own, and for a tensor that is no rigid body's where
    that matters; `OSError` for no place.
    """
    tree = body.in_space()
    left_out = [
        ("priors (written: their means)", body.has_priors or bool(getattr(body, "uncertainty", None))),
        ("learned scalars (written: where they start)", bool(body.learned)),
        ("limits and servos of motors", any(_is_more(own.motor) for own in tree.joint_parts)),
    ]
    if omitted := [words for words, there in left_out if there]:
        warnings.warn(f"{path}: MJCF cannot say {'; nor '.join(omitted)}", UserWarning, stacklevel=2)
    root = Element("mujoco", model=tree.name)
    SubElement(root, "compiler", angle="radian")
    SubElement(root, "option", gravity=_text(np.array(tree.gravity)))
    _Writer(tree).children(SubElement(root, "worldbody"), -1, WORLD_POSE)
    indent(root)
    write_whole(path, tostring(root, encoding="unicode") + "\n")


class _Writer:
    def __init__(self, tree: Body):
        self.tree, self.p, self.turning = tree, tree.parameters(), turning(tree.links, tree.parents)

    def children(self, element: Element, parent: int, frame: _Pose) -> None:
        """Write the links on a parent, whose element and frame are given."""
        for place, inner in enumerate(self.tree.parents):
            if inner == parent:
                self._link(element, frame, place, [])

    def _link(self, element: Element, outer: _Pose, place: int, waiting: list[_Moves]) -> None:
        """One link within an element and its frame; `waiting` are the joints of massless links between them."""
        link, own = self.tree.links[place], self._pose(place)
        joint_axes = own.axes @ np.array(link.joint.reference).T
        moves = waiting + [
            _Moves(motion.name, motion.turns, joint_axes @ motion.axis, own.origin, link.parts)
            for motion in link.joint.motions()
        ]
        children = [child for child, inner in enumerate(self.tree.parents) if inner == place]
        massless = moves and not self.p.mass[place] and not self.p.inertia[place].any()
        if massless and len(children) == 1 and not link.points:
            self._link(element, outer, children[0], moves)
            return
        if massless:
            raise BodyError(
                f"link '{link.name}': MuJoCo has no massless link that moves, but for one with a single child and no "
                "site; give it a mass and an inertia"
            )
        body = SubElement(element, "body", {"name": link.name, **_placed(own, outer)})
        for move in moves:
            given = {"axis": _text(own.axes.T @ move.axis), "pos": _text(own.axes.T @ (move.point - own.origin))}
            kind = {"name": move.name, "type": "hinge" if move.turns else "slide"}
            SubElement(body, "joint", kind | given | _besides(move.parts))
        if self.p.mass[place] or self.p.inertia[place].any():
            SubElement(body, "inertial", self._inertial(place, bool(moves)))
        sites = {name: self.p.sites[self.tree.keypoint_names.index(name)].numpy() for name in link.points}
        for name, at in sites.items():
            SubElement(body, "site", name=name, pos=_text(at))
        for end in (*sites.values(), *(own.axes.T @ (self._pose(child).origin - own.origin) for child in children)):
            if (length := float(np.linalg.norm(end))) > 0:
                shown = {"type": "capsule", "fromto": _text(np.concatenate([np.zeros(3), end]))}
                SubElement(
                    body,
                    "geom",
                    {**shown, "size": repr(THIN * length), "mass": "0", "contype": "0", "conaffinity": "0"},
                )
        self.children(body, place, own)

    def _pose(self, place: int) -> _Pose:
        """A link's frame."""
        if place < 0:
            return WORLD_POSE
        link, outer = self.tree.links[place], self._pose(self.tree.parents[place])
        axes = outer.axes @ np.array(link.rotation) @ np.array(link.joint.reference)
        return _Pose(axes, outer.origin + outer.axes @ self.p.position[place].numpy())

    def _inertial(self, place: int, moves: bool) -> dict[str, str]:
        mass, com, matrix = self.p.mass[place].item(), self.p.com[place].numpy(), tensor(self.p.inertia[place].numpy())
        moments, axes = np.linalg.eigh(matrix)
        if axes[:, 2] @ np.cross(axes[:, 0], axes[:, 1]) < 0:
            axes[:, 0] *= -1
        excess = moments[2] - moments[0] - moments[1]
        if excess > ROUNDING * moments[2] or moments[0] < -ROUNDING * moments[2]:
            moments, axes = np.full(3, self._needed(place, matrix)), np.eye(3)
        elif excess > 0:
            moments[2] -= 2 * excess
        if moves:
            moments, mass = np.maximum(moments, MIN_INERTIAL), max(mass, MIN_INERTIAL)
        return {
            "mass": repr(mass),
            "pos": _text(com),
            "diaginertia": _text(np.maximum(moments, 0.0)),
            "quat": _text(_quaternion(axes)),
        }

    def _needed(self, place: int, matrix: np.ndarray) -> float:
        """The one moment of a link that matters, where its tensor is no rigid body's."""
        turning = self.turning[place]
        if not len(turning):
            return 0.0
        if np.linalg.matrix_rank(turning, tol=1e-9) > 1:
            raise BodyError(
                f"link '{self.tree.links[place].name}': MuJoCo wants principal moments of which none exceeds the "
                "sum of the two others, not even by rounding"
            )
        return float(turning[0] @ matrix @ turning[0] / (turning[0] @ turning[0]))


def _besides(parts: JointParts | None) -> dict[str, str]:
    """A joint's friction, rotor and spring as attributes of MuJoCo's."""
    own = parts or NOTHING
    values = {
        "damping": own.damping,
        "frictionloss": own.friction,
        "armature": own.armature,
        "stiffness": own.stiffness,
        "springref": own.rest if own.stiffness else 0.0,
    }
    return {name: repr(value) for name, value in values.items() if value}


def _is_more(motor: Motor | None) -> bool:
    """Whether a motor is anything but one that gives its commanded torque."""
    return motor is not None and (motor.kind != "torque" or motor.limited)


def _placed(own: _Pose, outer: _Pose) -> dict[str, str]:
    return {
        "pos": _text(outer.axes.T @ (own.origin - outer.origin)),
        "quat": _text(_quaternion(outer.axes.T @ own.axes)),
    }


def _quaternion(axes: np.ndarray) -> np.ndarray:
    return Rotation.from_matrix(axes).as_quat(canonical=True)[[3, 0, 1, 2]]


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)
