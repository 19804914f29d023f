"""Messages of ROS as tracks: sensor_msgs/JointState, trajectory_msgs/JointTrajectory, std_msgs/Float64MultiArray.

    /joint_states.elbow.position, .velocity, .effort          one track for each joint and quantity
    /arm/joint_trajectory.elbow.position, …                   targets: of each message its first point
    /arm/commands.0                                           numbers in a row

Times are the messages' own stamps where a topic has any, else those at which they were logged (:func:`_times`).
JointState is in rad, rad/s, N·m by its definition.
"""

import warnings
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..budget import NUMBERS, TRACKS, Budget
from ..errors import InputError, first_line
from .tracks import Episode, Needed, Track

PACKAGES = {
    "JointState": "sensor_msgs",
    "JointTrajectory": "trajectory_msgs",
    "Float64MultiArray": "std_msgs",
    "Float32MultiArray": "std_msgs",
}
"""Types that are read, and where they are defined."""
TARGETS = ("JointTrajectory",)
QUANTITIES = ("position", "velocity", "effort")
POINT = {"position": "positions", "velocity": "velocities", "effort": "effort"}
PAUSE = 10
"""Median intervals between a stamp of 0 and the next one, at most, where 0 is a time."""


@dataclass
class _Topic:
    """Messages' stamps and times of logging, ns; of each track the numbers of its messages, and values."""

    target: bool
    stamps: array = field(default_factory=lambda: array("q"))
    logged: array = field(default_factory=lambda: array("q"))
    tracks: dict[str, tuple[array, array]] = field(default_factory=dict)


def known(kind: str, encoding: str) -> str | None:
    """A type's name as ROS 2 has it, of one as ROS 1, ROS 2 or JSON has it; None for a type that is not read."""
    package, _, name = kind.replace(".", "/").rpartition("/")
    own = PACKAGES.get(name)
    if own is None or (encoding != "json" and package not in (own, f"{own}/msg")):
        return None
    return f"{own}/msg/{name}"


class Collected:
    """Numbers of a log's messages, gathered by track.

    Args:
        needed: the tracks that are needed; None for all. Of any other topic the first message gives the names.
        budget: of the log.
    """

    def __init__(self, needed: Needed | None, budget: Budget) -> None:
        self.budget = budget
        self._needed = needed
        self._topics: dict[str, _Topic] = {}
        self._skipped: Counter[str] = Counter()
        self._count = 0

    def wants(self, topic: str) -> bool:
        """Whether the next message of that topic is to be added."""
        return self._needed is None or self._needed.source(topic) or topic not in self._topics

    def skip(self, kind: str, encoding: str) -> None:
        """Take note of messages that are not read."""
        self._skipped[f"{kind:.60} ({encoding or 'no encoding':.20})"] += 1

    def add(self, topic: str, kind: str, message: Any, logged: int) -> None:
        """Take a message of a type's name ("sensor_msgs/msg/JointState") that was logged at a time, ns.

        Raises InputError where its fields are not those of the type, as JSON's may be, and beyond the budget.
        """
        name = kind.rpartition("/")[2]
        own = self._topics.setdefault(topic, _Topic(name in TARGETS))
        number = len(own.stamps)
        try:
            own.stamps.append(_stamp(message))
            own.logged.append(logged)
            for track, value in _numbers(name, message):
                if track not in own.tracks:
                    self._count += 1
                    if self._count > TRACKS:
                        raise InputError(f"it has more than {TRACKS} tracks: export fewer topics")
                    own.tracks[track] = array("I"), array("d")
                rows, values = own.tracks[track]
                rows.append(number)
                values.append(value)
                self.budget.count(1)
        except InputError:
            raise
        except (TypeError, ValueError, LookupError, OverflowError, AttributeError) as error:
            raise InputError(f"a message of {topic:.100} is no {kind} ({first_line(error):.200})") from None

    def episode(self) -> Episode:
        """The tracks, from time 0 on. Raises InputError where there is none, with the types that were not read."""
        if not self._topics:
            others = ", ".join(name for name, _ in self._skipped.most_common(8))
            raise InputError(
                f"expected messages of {', '.join(PACKAGES)} in CDR, JSON or ROS 1's format, it has {others or 'none'}"
            )
        times = {topic: _times(own, topic) for topic, own in self._topics.items()}
        begin = min((int(time[use].min()) for time, use in times.values() if use.any()), default=0)

        found = {}
        for topic, own in self._topics.items():
            time, use = times[topic]
            second = np.where(use, (time - begin) * 1e-9, np.nan)
            for name, (rows, values) in own.tracks.items():
                found[f"{topic}.{name}"] = Track.of(second[np.array(rows)], np.array(values), own.target)
        return found


def _times(own: _Topic, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) ns of a topic's messages, and which of them (N,) have one.

    A stamp of 0 is a time where a simulation starts: one message, soon before the next. Several such, or one long
    before the rest, were sent before the first message of the clock, and have no time.
    """
    stamps, logged = np.array(own.stamps), np.array(own.logged)
    without = stamps == 0
    if without.all():
        return logged, np.ones(len(logged), dtype=bool)

    rest = np.sort(stamps[~without])
    interval = float(np.median(np.diff(rest))) if len(rest) > 1 else 0.0
    if without.sum() == 1 and abs(rest[0]) <= PAUSE * interval:
        return stamps, np.ones(len(stamps), dtype=bool)
    if without.any():
        warnings.warn(
            f"{topic}: {without.sum()} of {len(stamps)} messages have the time stamp 0, as before the first message "
            "of the clock: they are not used",
            stacklevel=2,
        )
    return stamps, ~without


def _of(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _stamp(message: Any) -> int:
    """Nanoseconds of a header's stamp; 0 where there is none."""
    header = _of(message, "header")
    stamp = None if header is None else _of(header, "stamp")
    if stamp is None:
        return 0
    nanoseconds = _of(stamp, "nanosec")
    if nanoseconds is None:
        nanoseconds = _of(stamp, "nsec") or 0
    return round((_of(stamp, "sec") or 0) * 10**9) + round(nanoseconds)


def _numbers(kind: str, message: Any) -> Iterator[tuple[str, float]]:
    if kind == "JointState":
        yield from _of_joints(_of(message, "name"), {name: _of(message, name) for name in QUANTITIES})
    elif kind == "JointTrajectory":
        points = _of(message, "points")
        if points is not None and len(points):
            yield from _of_joints(_of(message, "joint_names"), {n: _of(points[0], own) for n, own in POINT.items()})
    elif kind in ("Float64MultiArray", "Float32MultiArray"):
        data = _of(message, "data")
        if len(data) > NUMBERS:
            raise ValueError(f"{len(data)} numbers")
        for k, value in enumerate(data):
            yield str(k), float(value)


def _of_joints(joints: Any, quantities: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """Each joint's numbers; a quantity may be left out."""
    for quantity, values in quantities.items():
        for joint, value in zip(joints or (), () if values is None else values, strict=False):
            if not isinstance(joint, str):
                raise TypeError(f"a joint is called {joint!r:.40}")
            yield f"{joint}.{quantity}", float(value)
