"""Messages of ROS as tracks: sensor_msgs/JointState, trajectory_msgs/JointTrajectory, std_msgs/Float64MultiArray.

    /joint_states.elbow.position, .velocity, .effort          one track for each joint and quantity
    /arm/joint_trajectory.elbow.position, …                   targets: of each message its first point
    /arm/commands.0                                           numbers in a row

Times are the messages' own stamps where a topic has any, else those at which they were logged (:func:`_times`).
JointState is in rad, rad/s, N·m by its definition.
"""

import warnings
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..budget import Budget
from ..errors import InputError, first_line
from ..limits import LIMITS, PLAUSIBLE
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


Layout = tuple[tuple[str, tuple[str, ...] | int], ...]
"""The meaning of a message's numbers: quantities with their joints, or "" and the count."""


@dataclass
class _Topic:
    """Messages' stamps and times of logging, ns.

    Of each layout the indices of its messages, and their values in a row.
    """

    target: bool
    stamps: array = field(default_factory=lambda: array("q"))
    logged: array = field(default_factory=lambda: array("q"))
    layouts: dict[Layout, tuple[array, array]] = field(default_factory=dict)

    def tracks(self) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Each track's name, the indices (N,) of its messages and values (N,)."""
        parts: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        for layout, (rows, values) in self.layouts.items():
            own, matrix = np.array(rows), np.array(values).reshape(len(rows), -1)
            for k, name in enumerate(_names(layout)):
                parts.setdefault(name, []).append((own, matrix[:, k]))
        for name, found in parts.items():
            yield name, np.concatenate([own for own, _ in found]), np.concatenate([values for _, values in found])


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
        self._skipped: dict[str, None] = {}
        self._count = 0

    def wants(self, topic: str) -> bool:
        """Whether the next message of that topic is to be added."""
        return self._needed is None or self._needed.source(topic) or topic not in self._topics

    def skip(self, kind: str, encoding: str) -> None:
        """Record the type of messages that are not read."""
        if len(self._skipped) < LIMITS.tracks:
            self._skipped[f"{kind:.60} ({encoding or 'no encoding':.20})"] = None

    def add(self, topic: str, kind: str, message: Any, logged: int) -> None:
        """Take a message of a type's name ("sensor_msgs/msg/JointState") that was logged at a time, ns.

        Raises InputError where its fields are not those of the type, as JSON's may be, and beyond the budget.
        """
        name = kind.rpartition("/")[2]
        own = self._topics.setdefault(topic, _Topic(name in TARGETS))
        try:
            stamp, (layout, values) = _stamp(message), _numbers(name, message)
            self.budget.count(max(len(values), LIMITS.message_numbers))
            if not len(values):
                return

            if layout not in own.layouts:
                self._count += len(values)
                if self._count > LIMITS.tracks:
                    raise InputError(f"it has more than {LIMITS.tracks} tracks: export fewer topics")
                own.layouts[layout] = array("I"), array("d")
            rows, numbers = own.layouts[layout]
            rows.append(len(own.stamps))
            numbers.frombytes(values.tobytes())
            own.stamps.append(stamp)
            own.logged.append(logged)
        except InputError:
            raise
        except (TypeError, ValueError, LookupError, OverflowError, AttributeError) as error:
            raise InputError(f"a message of {topic:.100} is no {kind} ({first_line(error):.200})") from None

    def episode(self) -> Episode:
        """The tracks, from time 0 on. Raises InputError, with the types that were not read, where there is no track."""
        if not any(own.layouts for own in self._topics.values()):
            others = ", ".join([*(f"{topic:.60} without numbers" for topic in self._topics), *self._skipped][:8])
            raise InputError(
                f"expected messages of {', '.join(PACKAGES)} in CDR, JSON or ROS 1's format, it has {others or 'none'}"
            )
        times = {topic: _times(own, topic) for topic, own in self._topics.items() if own.layouts}
        begin = min((int(time[use].min()) for time, use in times.values() if use.any()), default=0)

        found = {}
        for topic, (time, use) in times.items():
            second, own = np.where(use, (time - begin) * 1e-9, np.nan), self._topics[topic]
            for name, rows, values in own.tracks():
                found[f"{topic}.{name}"] = Track.of(second[rows], values, own.target)
        return found


def _times(own: _Topic, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Times (N,) ns of a topic's messages, and which of them (N,) have one.

    A stamp of 0 is a time where a simulation starts: one message, soon before the next. Several such, or one long
    before the rest, precede the first message of the clock, and have no time.
    """
    stamps, logged = np.array(own.stamps), np.array(own.logged)
    without = stamps == 0
    if without.all():
        return logged, np.ones(len(logged), dtype=bool)

    rest = np.sort(stamps[~without])
    interval = float(np.median(np.diff(rest))) if len(rest) > 1 else 0.0
    if without.sum() == 1 and abs(rest[0]) <= PLAUSIBLE.first_interval * interval:
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
    seconds, nanoseconds = _of(stamp, "sec"), _of(stamp, "nanosec")
    if nanoseconds is None:
        nanoseconds = _of(stamp, "nsec")
    for part in (seconds, nanoseconds):
        if not isinstance(part, int | float | None):  # a text times 10⁹ would fill memory
            raise TypeError(f"its stamp has {part!r:.40}")
    return round((seconds or 0) * 10**9) + round(nanoseconds or 0)


def _numbers(kind: str, message: Any) -> tuple[Layout, np.ndarray]:
    """A message's numbers (N,), and their layout."""
    if kind == "JointState":
        return _of_joints(_of(message, "name"), {name: _of(message, name) for name in QUANTITIES})
    if kind == "JointTrajectory":
        points = _of(message, "points")
        first = points[0] if points is not None and len(points) else None
        return _of_joints(_of(message, "joint_names"), {name: _of(first, own) for name, own in POINT.items()})
    values = _values(_of(message, "data"))
    return (("", len(values)),), values


def _of_joints(joints: Any, quantities: dict[str, Any]) -> tuple[Layout, np.ndarray]:
    """Each joint's numbers; a quantity may be left out."""
    names = tuple(joints or ())
    if strange := [name for name in names if not isinstance(name, str)]:
        raise TypeError(f"a joint is called {strange[0]!r:.40}")

    values = {quantity: _values(given)[: len(names)] for quantity, given in quantities.items() if given is not None}
    layout = tuple((quantity, names[: len(each)]) for quantity, each in values.items())
    return layout, np.concatenate([np.empty(0), *values.values()])


def _values(given: Any) -> np.ndarray:
    """An array of a message, or JSON's list, as numbers; numpy alone would take None for one."""
    return np.asarray(given if isinstance(given, np.ndarray) else [float(each) for each in given], dtype=np.float64)


def _names(layout: Layout) -> Iterator[str]:
    """Names of a layout's numbers, in their order."""
    for quantity, joints in layout:
        if isinstance(joints, int):
            yield from map(str, range(joints))
        else:
            yield from (f"{joint}.{quantity}" for joint in joints)
