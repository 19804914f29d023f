"""Messages of ROS 2 as tracks: sensor_msgs/JointState, trajectory_msgs/JointTrajectory, std_msgs/Float64MultiArray.

    /joint_states.elbow.position, .velocity, .effort          one track for each joint and quantity
    /arm/joint_trajectory.elbow.position, …                   targets: of each message its first point
    /arm/commands.0                                           numbers in a row

A message's own stamp counts where it has one, else the time at which it was logged. JointState is in rad, rad/s, N·m by
its definition.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import InputError, first_line
from .tracks import Episode, Track

KINDS = ("JointState", "JointTrajectory", "Float64MultiArray", "Float32MultiArray")
QUANTITIES = ("position", "velocity", "effort")
POINT = {"position": "positions", "velocity": "velocities", "effort": "effort"}


class Collected:
    """Numbers of messages, gathered by track."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[list[float], list[float]]] = {}

    def add(self, topic: str, kind: str, message: Any, logged: float) -> None:
        """Take a message of a type's name ("sensor_msgs/msg/JointState") that was logged at a time, s.

        Raises InputError where its fields are not those of the type, as JSON's may be.
        """
        try:
            time, numbers = _stamp(message) or logged, [*_numbers(kind.rpartition("/")[2], message)]
        except (TypeError, ValueError, LookupError, OverflowError) as error:
            raise InputError(f"a message of {topic} is no {kind} ({first_line(error)})") from None
        for name, value in numbers:
            times, values = self._found.setdefault(f"{topic}.{name}", ([], []))
            times.append(time)
            values.append(value)

    def episode(self) -> Episode:
        """The tracks, from time 0 on."""
        begin = min((min(times) for times, _ in self._found.values()), default=0.0)
        return {
            name: Track.of(np.array(times) - begin, np.array(values)) for name, (times, values) in self._found.items()
        }


def _of(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _stamp(message: Any) -> float | None:
    """Seconds of a header's stamp; None where there is none, or zero."""
    stamp = _of(_of(message, "header"), "stamp") if _of(message, "header") is not None else None
    if stamp is None:
        return None
    nanoseconds = _of(stamp, "nanosec")
    if nanoseconds is None:
        nanoseconds = _of(stamp, "nsec") or 0
    return float(_of(stamp, "sec") or 0) + 1e-9 * float(nanoseconds) or None


def _numbers(kind: str, message: Any) -> Iterator[tuple[str, float]]:
    if kind == "JointState":
        for quantity in QUANTITIES:
            values = _of(message, quantity)
            for joint, value in zip(_of(message, "name") or (), () if values is None else values, strict=False):
                yield f"{joint}.{quantity}", float(value)
    elif kind == "JointTrajectory":
        points = _of(message, "points")
        first = points[0] if points is not None and len(points) else None
        for quantity, name in POINT.items():
            values = None if first is None else _of(first, name)
            for joint, value in zip(_of(message, "joint_names") or (), () if values is None else values, strict=False):
                yield f"{joint}.{quantity}", float(value)
    elif kind in ("Float64MultiArray", "Float32MultiArray"):
        for k, value in enumerate(_of(message, "data")):
            yield str(k), float(value)
