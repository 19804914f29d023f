"""Rigid parts out of URDF: links and joints as the format defines them (wiki.ros.org/urdf/XML).

    frame of a child = frame of its parent · origin of the joint,    origin = (xyz, Rz(yaw) Ry(pitch) Rx(roll))
    inertia in the world = R I Rᵀ, with R from the world to the inertial element's own origin

A mass comes from `<inertial>` alone: shapes say how a link looks and what it touches. A link without one is a massless
frame, lumped with what it is fixed to. Gravity is 9.81 m/s² downwards along z, which URDF leaves open.

MuJoCo's compiler gives the same numbers (4.0.0, to 1e-15), but refuses what files have: massless links between joints,
point masses, masses without a tensor, and tensors of which rounding leaves A + B < C.
"""

from collections.abc import Sequence
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.models.bodies import body_xml
from invdyn.models.bodies.joint_parts import NOTHING, JointParts, Motor
from invdyn.models.bodies.parts import Part, PartJoint, Robot, listed
from invdyn.models.bodies.scalars import BodyError, number

GRAVITY = np.array([0.0, 0.0, -9.81])
TYPES = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "floating": "free"}
TENSOR = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
KNOWN = ("link", "joint", "material")

Frame = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and place (3,)."""


def of(robot: Element, where: str) -> Robot:
    """The parts of a parsed URDF. Raises `BodyError` for what is no URDF or has a planar joint."""
    body_xml.check_root(robot, "robot", where)
    if any(each.tag.startswith("xacro:") for each in robot.iter()):
        raise BodyError(f"{where}: a xacro template is not read; expand it first: xacro FILE.xacro > FILE.urdf")
    links = _named(robot, "link", where)
    joints = _named(robot, "joint", where)
    root, below = _tree(links, joints, where)
    parts: list[Part] = []
    todo: list[tuple[str, int, list[PartJoint], Frame]] = [(root, -1, [], (np.eye(3), np.zeros(3)))]
    for name, parent, moves, frame in todo:  # parents come before their children
        parts.append(_part(links[name], name, parent, moves, frame, where))
        for joint, child in below.get(name, ()):
            own = _moved(frame, joint, where)
            todo.append((child, len(parts) - 1, _moves(joint, own, where), own))
    moving = [joint for joint in joints.values() if joint.get("type") != "fixed"]
    one_way = [joint for joint in moving if joint.get("type") != "floating"]
    return Robot(parts, GRAVITY, _left_out(robot, moving, one_way), _joint_parts(one_way, where))


def _named(robot: Element, tag: str, where: str) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for each in robot.findall(tag):
        name = each.get("name", "")
        if not name.strip() or name in found:
            raise BodyError(f"{where}: expected a name of its own for each {tag}, got {name!r:.60}")
        found[name] = each
    return found


def _tree(links: dict, joints: dict, where: str) -> tuple[str, dict[str, list[tuple[Element, str]]]]:
    """The root link's name; and joint and child of every link that has some."""
    below: dict[str, list[tuple[Element, str]]] = {}
    children = set()
    for name, joint in joints.items():
        ends = [_attribute(joint, tag, "link") or "" for tag in ("parent", "child")]
        for tag, end in zip(("parent", "child"), ends, strict=True):
            if end not in links:
                raise BodyError(f"{where}: joint '{name}' has '{end}' as its {tag}, which is no link of the file")
        if ends[1] in children:
            raise BodyError(f"{where}: link '{ends[1]}' is the child of two joints; expected a tree")
        children.add(ends[1])
        below.setdefault(ends[0], []).append((joint, ends[1]))
    roots = [name for name in links if name not in children]
    if len(roots) != 1:
        label = (
            f"got {', '.join(roots[:4])}" if roots else "but the joints form a loop" if links else "got no link at all"
        )
        raise BodyError(f"{where}: expected one link that is no joint's child, {label}")
    reached = {root := roots[0]}
    todo = [root]
    for name in todo:
        after = [child for _, child in below.get(name, ())]
        todo += after
        reached.update(after)
    if len(reached) < len(links):
        raise BodyError(f"{where}: the joints of '{next(n for n in links if n not in reached)}' form a loop")
    return root, below


def _attribute(parent: Element, tag: str, key: str) -> str | None:
    child = parent.find(tag)
    return None if child is None else child.get(key)


def _numbers(element: Element | None, key: str, default: str, where: str) -> np.ndarray:
    """Numbers of an attribute, as many as in `default`. Raises `BodyError`."""
    text = default if element is None else element.get(key, default)
    words, count = text.split(), len(default.split())
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count:
        raise BodyError(f"{where}: expected {count} number{'s' * (count > 1)} as {key}, got {text!r:.60}")
    return np.array([number(value, f"{where}: {key}") for value in values])


def _moved(frame: Frame, element: Element, where: str) -> Frame:
    """A frame moved by an element's `<origin>`, if it has one."""
    origin = element.find("origin")
    xyz, rpy = (_numbers(origin, key, "0 0 0", where) for key in ("xyz", "rpy"))
    turn, place = frame
    return turn @ Rotation.from_euler("xyz", rpy).as_matrix(), place + turn @ xyz


def _moves(joint: Element, frame: Frame, where: str) -> list[PartJoint]:
    """The joint, none where it is fixed."""
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind == "fixed":
        return []
    if kind not in TYPES:
        raise BodyError(f"{where}: expected joints of type {', '.join(TYPES)} or fixed, '{name}' is of type {kind:.60}")
    if TYPES[kind] == "free":
        return [PartJoint(name, frame[1], np.zeros(3), "free")]
    axis = _numbers(joint.find("axis"), "xyz", "1 0 0", f"{where}: axis of joint '{name}'")
    size = np.linalg.norm(axis)
    if not 0 < size < np.inf:
        raise BodyError(f"{where}: joint '{name}' has an axis without direction")
    return [PartJoint(name, frame[1], frame[0] @ (axis / size), TYPES[kind])]


def _part(link: Element, name: str, parent: int, joints: list[PartJoint], frame: Frame, where: str) -> Part:
    label = f"{where}: link '{name}'"
    inertial = link.find("inertial")
    mass, (turn, com), tensor = 0.0, frame, np.zeros((3, 3))
    if inertial is not None:
        turn, com = _moved(frame, inertial, label)
        if inertial.find("mass") is None:
            raise BodyError(f"{label}: its inertial element lacks a mass")
        mass = float(_numbers(inertial.find("mass"), "value", "nan", label)[0])
        own = inertial.find("inertia")
        tensor = np.array([[_numbers(own, key, "0", label)[0] for key in row] for row in TENSOR])
        if mass < 0:
            raise BodyError(f"{label}: expected no negative mass, got {mass:g} kg")
    return Part(
        name, parent, mass, com, turn @ tensor @ turn.T, frame[1], frame[0], joints, ends=_ends(link, frame, label)
    )


def _ends(link: Element, frame: Frame, where: str) -> list[np.ndarray]:
    """Both ends of each shape along its longest axis; a sphere's centre; nothing of a mesh, which is not looked at."""
    found = []
    for shape in (*link.findall("collision"), *link.findall("visual")):
        half = None
        for tag, key, default in (("box", "size", "0 0 0"), ("cylinder", "length", "0"), ("capsule", "length", "0")):
            if (solid := shape.find(f"geometry/{tag}")) is not None:
                size = _numbers(solid, key, default, where)
                longest = int(size.argmax()) if len(size) == 3 else 2
                half = size.max() / 2 * np.eye(3)[longest]
        if shape.find("geometry/sphere") is not None:
            half = np.zeros(3)
        if half is not None:
            turn, centre = _moved(frame, shape, where)
            found += [centre - turn @ half, centre + turn @ half]
    return found


def _joint_parts(moving: Sequence[Element], where: str) -> dict[str, JointParts]:
    """Damping and friction of `<dynamics>`, and the limit of `<limit effort>`, of each joint that has any."""
    found = {}
    for joint in moving:
        name = joint.get("name", "")
        label = f"{where}: joint '{name}'"
        damping, friction = (
            float(_numbers(joint.find("dynamics"), key, "0", label)[0]) for key in ("damping", "friction")
        )
        effort = float(_numbers(joint.find("limit"), "effort", "0", label)[0])
        motor = Motor(low=-effort, high=effort) if effort > 0 else None
        try:
            parts = JointParts(damping, friction, motor=motor)
        except BodyError as error:
            raise BodyError(f"{label}: {error}") from error
        if parts != NOTHING:
            found[name] = parts
    return found


def _is_said(text: str) -> bool:
    """Whether a number is any but 0; what is left out may be too large, or none."""
    try:
        return float(text) != 0
    except ValueError:
        return True


def _left_out(robot: Element, moving: list[Element], one_way: list[Element]) -> list[str]:
    """What the file says and links lack, whose ``one_way`` joints have their parts (:func:`_joint_parts`)."""
    floating = [joint for joint in moving if joint not in one_way]

    def having(tag: str, *keys: str, among: list[Element] = moving) -> list[str]:
        found = []
        for joint in among:
            element = joint.find(tag)
            if element is not None and (not keys or any(_is_said(element.get(key, "0")) for key in keys)):
                found.append(joint.get("name", ""))
        return found

    followers = [
        f"{joint.get('name')} follows {_attribute(joint, 'mimic', 'joint')}"
        for joint in moving
        if joint.find("mimic") is not None
    ]
    strange = sorted({each.tag for each in robot if each.tag not in KNOWN})
    return [
        *listed("damping", having("dynamics", "damping", among=floating)),
        *listed("dry friction", having("dynamics", "friction", among=floating)),
        *listed("limits", having("limit", "lower", "upper")),
        *listed("limits of torque", having("limit", "effort", among=floating)),
        *listed("limits of speed", having("limit", "velocity")),
        *listed("mimic, a joint that follows another", followers),
        *listed("safety controllers", having("safety_controller")),
        *listed("elements of other programs", [f"<{tag:.40}>" for tag in strange]),
    ]
