"""Within what a robot may move: angles, speeds, accelerations and torques of its joints, and the space of its points.

A robot's file gives the range of a joint (MJCF, URDF), its speed (URDF) and its torque. What it does not give, and what
is to be narrower, a table says:

    [all]                        # of every joint
    speed = 1.0                  # rad/s
    acceleration = 3.0           # rad/s²
    [elbow]                      # of one joint, in the file's own angle
    position = [-1.0, 2.0]       # rad
    torque = 12.0                # N·m
    [space]                      # of every keypoint of the body, m
    z = [0.05, 0.9]

Slides are in m, m/s, m/s² and N.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.models import Body
from invdyn.models.bodies.body_xml import is_xml
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.recordings import InputError
from invdyn.recordings.budget import read_toml

QUANTITIES = ("position", "speed", "acceleration", "torque")


@dataclass(frozen=True)
class MotionLimits:
    """Of K joints, in the body's coordinates: rad, rad/s, rad/s², N·m; and of the points' space (d, 2), m.

    `assumed` says in words what neither the file nor a table gave.
    """

    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray
    space: np.ndarray
    assumed: tuple[str, ...] = ()

    @property
    def middle(self) -> np.ndarray:
        """(K,) of the ranges."""
        return (self.low + self.high) / 2

    @property
    def half(self) -> np.ndarray:
        """(K,) half of the ranges."""
        return (self.high - self.low) / 2


def motion_limits(
    body: Body, robot: str | Path | None = None, table: str | Path | None = None, joints: Sequence[str] = ()
) -> MotionLimits:
    """Limits of a body, whose file is ``robot``, narrowed by a ``table`` as at the top of this file.

    Of ``joints`` that move, all if none, a range is needed; another one without a range stands at the file's zero.
    Raises InputError for a joint without a range, an unknown name, a range that is empty, a motor that pushes one way
    alone, and what is no number.
    """
    own = _of_file(robot) if robot is not None else {}
    tables = {} if table is None else dict(read_toml(table, "limits"))
    axes = tables.pop("space", {})
    shared = _checked(tables.pop("all", {}), f"{table}: [all]")
    if strange := [name for name in tables if name not in body.joint_names]:
        raise InputError(f"{table}: unknown joint {strange[0]!r}: expected one of {', '.join(body.joint_names)}")
    rows, assumed = [], []
    for name, part in zip(body.joint_names, body.joint_parts, strict=True):
        given = shared | _checked(tables.get(name, {}), f"{table}: [{name}]")
        row = _of_joint(own.get(name, {}), given, part)
        if row["position"] is None and joints and name not in joints:
            row["position"] = [part.zero, part.zero]
        elif row["position"] is None:
            raise InputError(
                f"joint '{name}' has no range: give one in a table of limits, such as [{name}] position = [-1.0, 1.0]"
            )
        elif not row["position"][0] < row["position"][1]:
            raise InputError(f"joint '{name}': expected a range, low < high, got {row['position']}")
        if not row["torque"] > 0:
            raise InputError(f"joint '{name}': expected a motor that pushes both ways, got one way alone")
        if row["speed"] is None:
            row["speed"] = FIXED.excite_usual_speed
            assumed.append(f"{name}: {FIXED.excite_usual_speed:g} rad/s")
        row["acceleration"] = row["acceleration"] or row["speed"] / FIXED.excite_usual_rise
        rows.append(row)
    low, high = np.array([row["position"] for row in rows]).T
    speed, acceleration, torque = (np.array([row[word] for row in rows], dtype=float) for word in QUANTITIES[1:])
    space = _space(axes, body.dimensions, str(table))
    return MotionLimits(low, high, speed, acceleration, torque, space, tuple(assumed))


def _of_joint(own: Mapping[str, Any], given: Mapping[str, Any], part: JointParts) -> dict[str, Any]:
    """The narrower of the file's and the table's, in the body's coordinate θ = zero + sign · q."""

    def narrower(word: str, least: float | None = None) -> float | None:
        every = [each for each in (own.get(word), given.get(word), least) if each is not None]
        return min(every) if every else None

    ranges = [each["position"] for each in (own, given) if each.get("position") is not None]
    position = None
    if ranges:
        ends = max(r[0] for r in ranges), min(r[1] for r in ranges)
        position = sorted(part.zero + part.sign * end for end in ends) if ends[0] < ends[1] else list(ends)
    motor = np.inf if part.motor is None else min(-part.motor.low, part.motor.high)
    torque = narrower("torque", float(motor))
    return {
        "position": position,
        "speed": narrower("speed"),
        "acceleration": narrower("acceleration"),
        "torque": torque,
    }


def _checked(given: Any, where: str) -> dict[str, Any]:
    """A joint's table, its numbers as such."""
    if not isinstance(given, Mapping):
        raise InputError(f"{where}: expected a table with {', '.join(QUANTITIES)}, got {given!r:.40}")
    if strange := [key for key in given if key not in QUANTITIES]:
        raise InputError(f"{where}: unknown {strange[0]!r}: expected {', '.join(QUANTITIES)}")
    found: dict[str, Any] = {}
    for key, value in given.items():
        found[key] = _pair(value, f"{where}: {key}") if key == "position" else _number(value, f"{where}: {key}")
        if key != "position" and found[key] <= 0:
            raise InputError(f"{where}: expected a {key} above 0, got {value!r:.40}")
    return found


def _space(axes: Any, dimensions: int, table: str) -> np.ndarray:
    """(d, 2) m."""
    names = "xyz"[:dimensions]
    if not isinstance(axes, Mapping) or set(axes) - set(names):
        raise InputError(f"{table}: [space]: expected ranges of {', '.join(names)}, got {axes!r:.40}")
    return np.array([_pair(axes[a], f"{table}: [space]: {a}") if a in axes else (-np.inf, np.inf) for a in names])


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{where}: expected a number, got {value!r:.40}")
    return float(value)


def _pair(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise InputError(f"{where}: expected [low, high], got {value!r:.40}")
    low, high = (_number(each, where) for each in value)
    if not low < high:
        raise InputError(f"{where}: expected low < high, got {value!r:.40}")
    return low, high


def _of_file(robot: str | Path) -> dict[str, dict[str, Any]]:
    """What a robot's own file says of each joint, in its own angles; nothing of a body's TOML."""
    content = Path(robot).read_bytes()
    if not is_xml(content):
        return {}
    if b"<mujoco" in content:
        return _of_mjcf(robot)
    found: dict[str, dict[str, Any]] = {}
    for joint in ElementTree.fromstring(content).iter("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        given = {key: float(value) for key in ("lower", "upper", "velocity") if (value := limit.get(key)) is not None}
        own: dict[str, Any] = {}
        if joint.get("type") != "continuous" and {"lower", "upper"} <= set(given):
            own["position"] = given["lower"], given["upper"]
        if given.get("velocity", 0.0) > 0:
            own["speed"] = given["velocity"]
        found[joint.get("name", "")] = own
    return found


def _of_mjcf(robot: str | Path) -> dict[str, dict[str, Any]]:
    import mujoco

    from invdyn.models.bodies.joint_parts_mjcf import joint_names

    model = mujoco.MjModel.from_xml_path(str(robot))
    limited = {name: j for j, name in enumerate(joint_names(model)) if model.jnt_limited[j]}
    return {name: {"position": tuple(map(float, model.jnt_range[j]))} for name, j in limited.items()}


def with_joints(limits: MotionLimits, joints: np.ndarray) -> MotionLimits:
    """The same for motions of some ``joints`` (K,) bool: the others stand in the middle of their ranges."""
    low = np.where(joints, limits.low, limits.middle)
    return replace(limits, low=low, high=np.where(joints, limits.high, limits.middle))
