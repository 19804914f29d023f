"""Rigid parts out of an OpenSim model (.osim of version 4: <OpenSimDocument>), as OpenSim's own classes define them.

    frame of a child = frame of its parent · offset · joint · (offset of the child)⁻¹,    offset = (t, Rx Ry Rz)
    joint            = shifts along axes of the parent's offset frame, then R(a₁, θ₁) R(a₂, θ₂) R(a₃, θ₃)

Each axis of a CustomJoint moves by a function of a coordinate: q, −q, either with an offset, or a constant. Pin,
slider, universal, ball, gimbal, planar and free joints are the same with fixed axes. Locked coordinates stand where the
file puts them. So does what another coordinate moves by a curve, such as the shift of a knee: it is fixed at the
coordinate's default and named, as muscles, constraints and wrapping surfaces are.

Coordinates keep their names, zeros and signs, so that angles of a .mot fit as they are. OpenSim's ground has y up and
ours z: all is rotated by (x, y, z) ↦ (x, −z, y), as markers of a .trc are. Markers are the sites.

https://simtk.org/api_docs/opensim/api_docs/classOpenSim_1_1CustomJoint.html
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.models.bodies import body_xml
from invdyn.models.bodies.osim_functions import numbers, unwrapped, value
from invdyn.models.bodies.parts import Part, PartJoint, Robot, listed
from invdyn.models.bodies.scalars import BodyError

Frame = tuple[np.ndarray, np.ndarray]
"""Axes as columns (3, 3) and origin (3,)."""
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
GROUND = "ground"
X, Y, Z = np.eye(3)
PLAIN: dict[str, tuple[list[np.ndarray], list[np.ndarray]]] = {
    "PinJoint": ([Z], []),
    "SliderJoint": ([], [X]),
    "UniversalJoint": ([X, Y], []),
    "BallJoint": ([X, Y, Z], []),
    "GimbalJoint": ([X, Y, Z], []),
    "PlanarJoint": ([Z], [X, Y]),
    "FreeJoint": ([X, Y, Z], [X, Y, Z]),
    "WeldJoint": ([], []),
}
"""Axes of rotations and of shifts of a joint's coordinates, in the file's order: rotations first."""
OTHERS = {"constraints": "ConstraintSet", "controllers": "ControllerSet", "contact surfaces": "ContactGeometrySet"}


@dataclass
class _Axis:
    """A rotation about, or shift along, an axis: offset + sign · coordinate; a constant where there is none."""

    axis: np.ndarray
    turns: bool
    offset: float = 0.0
    coordinate: str | None = None


@dataclass
class _Read:
    """What was read so far."""

    bodies: Mapping[str, Element]
    where: str
    frames: dict[str, Frame]
    parts: list[Part] = field(default_factory=list)
    places: dict[str, int] = field(default_factory=lambda: {GROUND: -1})
    coupled: list[str] = field(default_factory=list)
    dependent: frozenset[str] = frozenset()
    unplaced: list[str] = field(default_factory=list)


def of(document: Element, where: str) -> Robot:
    """The parts of a parsed model. Raises `BodyError`, which begins with ``where``, for what is none of version 4."""
    body_xml.check_root(document, "OpenSimDocument", where)
    model = document.find("Model")
    if model is None:
        raise BodyError(f"{where}: expected a <Model> in the OpenSim document, got none")
    joints = model.findall("JointSet/objects/*")
    if not joints:
        raise BodyError(
            f"{where}: expected a JointSet with joints, as OpenSim 4 writes it; open an older file there and save it"
        )
    bodies = {body.get("name", ""): body for body in model.findall("BodySet/objects/Body")}
    dependent = frozenset(text.strip() for text in map(_dependent, model.iter("CoordinateCouplerConstraint")))
    read = _Read(bodies, where, {GROUND: (Y_UP, np.zeros(3))}, dependent=dependent)
    waiting = list(joints)
    while waiting:
        ready = next((each for each in waiting if _end(each, "parent", where)[0] in read.places), None)
        if ready is None:
            raise BodyError(f"{where}: joint '{waiting[0].get('name')}' hangs on no body that hangs on the ground")
        waiting.remove(ready)
        _add(read, ready)
    if unattached := [name for name in bodies if name not in read.places]:
        raise BodyError(f"{where}: body '{unattached[0]}' hangs on nothing: expected a joint of which it is the child")
    gravity = Y_UP @ numbers(model, "gravity", where, "0 -9.80665 0")
    parts = [*_marked(read, model)]
    return Robot(parts, gravity, named(model, read.coupled, read.unplaced), angles_are_free=False)


def _add(read: _Read, joint: Element) -> None:
    """Append the part that a joint moves."""
    name, where = joint.get("name", ""), f"{read.where}: joint '{joint.get('name')}'"
    parent, outer = _end(joint, "parent", read.where)
    child, inner = _end(joint, "child", read.where)
    if child not in read.bodies or child in read.places:
        raise BodyError(f"{where}: expected a body of its own as its child, got '{child}'")
    turn, place = _after(read.frames[parent], outer)
    moves: list[PartJoint] = []
    axes = _axes(joint, where, read.coupled, read.dependent)
    shifts, turns = ([each for each in axes if each.turns == rotates] for rotates in (False, True))
    place = place + sum((turn @ each.axis * each.offset for each in shifts), np.zeros(3))
    moves += [PartJoint(each.coordinate, place, turn @ each.axis, "slide") for each in shifts if each.coordinate]
    for each in turns:
        turn = turn @ Rotation.from_rotvec(each.axis * each.offset).as_matrix()
        if each.coordinate is not None:
            moves.append(PartJoint(each.coordinate, place, turn @ each.axis))
    own, origin = _after((turn, place), _inverse(inner))
    body, label = read.bodies[child], f"{read.where}: body '{child}'"
    xx, yy, zz, xy, xz, yz = numbers(body, "inertia", label, "0 0 0 0 0 0")
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    (mass,) = numbers(body, "mass", label, "0")
    if mass < 0:
        raise BodyError(f"{label}: expected no negative mass, got {mass:g} kg")
    com = origin + own @ numbers(body, "mass_center", label, "0 0 0")
    read.frames[child], read.places[child] = (own, origin), len(read.parts)
    read.parts.append(Part(child, read.places[parent], mass, com, own @ tensor @ own.T, origin, own, moves))
    if any(move.name == other.name for part in read.parts[:-1] for other in part.joints for move in moves):
        raise BodyError(f"{where}: expected coordinates with names of their own, got one of another joint in '{name}'")


def _axes(joint: Element, where: str, coupled: list[str], dependent: Collection[str]) -> list[_Axis]:
    """What a joint does at all its axes, rotations first; what is fixed of it is appended to ``coupled``.

    ``dependent`` coordinates follow another joint's, as a kneecap's does, and need not move an axis of their own.
    """
    coordinates = {each.get("name", ""): each for each in joint.findall("coordinates/Coordinate")}
    if joint.tag in PLAIN:
        turns, shifts = PLAIN[joint.tag]
        if len(coordinates) != len(turns) + len(shifts):
            raise BodyError(f"{where}: expected {len(turns) + len(shifts)} coordinates, got {len(coordinates)}")
        axes = [(axis, axis_turns) for each, axis_turns in ((turns, True), (shifts, False)) for axis in each]
        found = [_Axis(axis, turns, 0.0, name) for (axis, turns), name in zip(axes, coordinates, strict=True)]
    elif joint.tag == "CustomJoint":
        own = joint.findall("SpatialTransform/TransformAxis")
        if len(own) != 6:
            raise BodyError(f"{where}: expected a SpatialTransform of three rotations and three shifts")
        found = [_custom(each, n < 3, coordinates, where) for n, each in enumerate(own)]
        fixed = [each for each in found if each.coordinate and each.coordinate.startswith("=")]
        for each in fixed:
            words = "rotation" if each.turns else "shift"
            line = f"a {words} of {joint.get('name')} with {str(each.coordinate)[1:]}"
            coupled += [] if line in coupled else [line]
            each.coordinate = None
        if idle := [name for name in coordinates if name not in {*dependent, *(each.coordinate for each in found)}]:
            raise BodyError(f"{where}: coordinate '{idle[0]}' moves no axis by itself: expected q or −q of one")
    else:
        known = ", ".join([*PLAIN, "CustomJoint"])
        raise BodyError(f"{where}: expected a joint among {known}, got {joint.tag:.60}")
    for each in found:
        if (
            each.coordinate is not None
            and coordinates[each.coordinate].findtext("locked", "").strip().lower() == "true"
        ):
            each.offset += _default(coordinates[each.coordinate], where)
            each.coordinate = None
    return found


def _custom(transform: Element, turns: bool, coordinates: Mapping[str, Element], where: str) -> _Axis:
    """One axis of a CustomJoint; one that follows a coordinate by a curve has it with "=" before its name."""
    axis = numbers(transform, "axis", where, "0 0 0")
    if not np.linalg.norm(axis) > 0:
        raise BodyError(f"{where}: an axis has no direction")
    axis = axis / np.linalg.norm(axis)
    names = (transform.findtext("coordinates") or "").split()
    function = next((each for each in transform if each.tag not in ("coordinates", "axis")), None)
    function, scale = unwrapped(function, where)
    if function is None or function.tag == "Constant" or not names:
        constant = 0.0 if function is None else value(function, 0.0, where)
        return _Axis(axis, turns, scale * constant)
    if len(names) > 1 or names[0] not in coordinates:
        raise BodyError(f"{where}: expected one of its own coordinates at each axis, got {', '.join(names)}")
    if function.tag == "LinearFunction":
        slope, offset = scale * numbers(function, "coefficients", where, "1 0")
        if abs(abs(slope) - 1) < 1e-9:
            return _Axis(np.sign(slope) * axis, turns, np.sign(slope) * offset, names[0])
    at = _default(coordinates[names[0]], where)
    return _Axis(axis, turns, scale * value(function, at, where), f"={names[0]}")


def _marked(read: _Read, model: Element) -> Iterator[Part]:
    """The parts with the markers that sit on them."""
    marks: dict[str, list[tuple[str, np.ndarray]]] = {}
    for marker in model.findall("MarkerSet/objects/Marker"):
        body = (marker.findtext("socket_parent_frame") or "").strip().rpartition("/")[2]
        if body in read.places and body != GROUND:
            turn, origin = read.frames[body]
            own = origin + turn @ numbers(marker, "location", read.where, "0 0 0")
            marks.setdefault(body, []).append((marker.get("name", ""), own))
        else:
            read.unplaced.append(marker.get("name", ""))
    for part in read.parts:
        yield Part(**{**vars(part), "marks": tuple(marks.get(part.name, ()))})


def _end(joint: Element, end: str, where: str) -> tuple[str, Frame]:
    """The body, or the ground, at a joint's end, "parent" or "child", and the joint's frame in it."""
    offsets = {each.get("name", ""): each for each in joint.findall("frames/PhysicalOffsetFrame")}
    name = (joint.findtext(f"socket_{end}_frame") or "").strip().rpartition("/")[2]
    frame: Frame = (np.eye(3), np.zeros(3))
    for _ in offsets:
        if name not in offsets:
            break
        offset, label = offsets[name], f"{where}: frame '{name}'"
        angles = numbers(offset, "orientation", label, "0 0 0")
        own = Rotation.from_euler("XYZ", angles).as_matrix(), numbers(offset, "translation", label, "0 0 0")
        frame = _after(own, frame)
        name = (offset.findtext("socket_parent") or "").strip().rpartition("/")[2]
    return name, frame


def _after(outer: Frame, inner: Frame) -> Frame:
    return outer[0] @ inner[0], outer[1] + outer[0] @ inner[1]


def _inverse(frame: Frame) -> Frame:
    return frame[0].T, -frame[0].T @ frame[1]


def _dependent(constraint: Element) -> str:
    return constraint.findtext("dependent_coordinate_name") or ""


def _default(coordinate: Element, where: str) -> float:
    return float(numbers(coordinate, "default_value", where, "0")[0])


def named(model: Element, coupled: Sequence[str], unplaced: Sequence[str] = ()) -> list[str]:
    """Entries of what is left out of a <Model>: ``coupled`` are movements that follow another one by a curve.

    ``unplaced`` are markers on the ground, or on a frame of their own.
    """
    forces = model.findall("ForceSet/objects/*")
    muscles = [each for each in forces if each.tag.endswith("Muscle")]
    rest = [each for each in forces if each not in muscles]
    moves = [each for each in model.iter("Coordinate") if (each.findtext("prescribed") or "").strip() == "true"]
    limits = [each for each in model.iter("Coordinate") if (each.findtext("clamped") or "").strip() == "true"]
    return [
        *listed("movements that follow another, held where the model has them by default", coupled),
        *listed("markers on no body", unplaced),
        *listed("muscles", _names(muscles)),
        *listed("other forces", _names(rest)),
        *(entry for words, tag in OTHERS.items() for entry in listed(words, _names(model.findall(f"{tag}/objects/*")))),
        *listed("wrapping surfaces", _names(model.findall(".//WrapObjectSet/objects/*"))),
        *listed("prescribed motions", _names(moves)),
        *listed("limits", _names(limits)),
    ]


def _names(elements: Sequence[Element]) -> list[str]:
    return [each.get("name", each.tag) for each in elements]
