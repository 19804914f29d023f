"""A mapping in TOML: which track of a log is which joint's angle, torque or target.

    time = "t"                       # a table's column of times; "time" by default
    time_unit = "ms"                 # s by default
    [joints.elbow]
    angle  = {track = "q2", unit = "deg", sign = -1, zero = 0.5}     # rad = zero + sign · value · unit; m of a slide
    torque = {track = "i2", gear = 50, constant = 0.12, sign = -1}   # N·m = sign · gear · constant · value
    target = {track = "action.2", unit = "deg", gear = 3}            # of a servo: an angle, or a velocity
                                     # feedforward = true in the line of a torque: it is added to the servo's
    [joints.hand]
    angle  = {track = "h", range = [0, 0.8], ends = [0, 100]}        # rad where the log has 0, and where it has 100

    [joints.roll]                                                    # of motors that add: a sum, a row of their matrix
    torque = [{track = "i5", gear = 45}, {track = "i6", gear = 32, sign = -1}]

Angles, torques and targets are those of the robot's own file, as it counts them. A gear converts the motor's
quantities to the joint's: a torque times it, an angle or target over it (MuJoCo's ctrl is gear · q). With a `range`
[a, b] the log's numbers are positions between the ends of a joint's range. These are `ends` [c, d], by default −100 and
100 as in LeRobot:

    rad = zero + sign · unit · (a + (value − c) (b − a)/(d − c)) / gear

A `range` may also be the name of LeRobot's calibration, which has the range of the track's motor about its middle
(:mod:`.lerobot`). Numbers that begin again after 4096 have `wrap = 4096`, and are one course then.

Without a mapping, tracks named as in ROS's JointState, "….elbow.position" and "….elbow.effort", are taken as their
names state.
"""

import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..budget import read_toml
from ..errors import InputError, about
from ..units import METRES, RADIANS, TIMES, Units
from .lerobot import calibrated_range
from .tracks import Episode, Needed, Track, track

ENDS = (-100.0, 100.0)
"""A log's numbers at the ends of a joint's range."""
ANGLES = {**RADIANS, "rev": 2 * np.pi, "rad/s": 1.0, "deg/s": RADIANS["deg"], "rpm": 2 * np.pi / 60}
SHIFTS = {**METRES, "m/s": 1.0, "cm/s": METRES["cm"], "mm/s": METRES["mm"]}
TORQUES = {"N·m": 1.0, "Nm": 1.0, "mN·m": 1e-3, "mNm": 1e-3, "kg·cm": 0.0980665, "A": 1.0, "mA": 1e-3}
BY_NAME = {"angle": "position", "torque": "effort"}
"""How the names of tracks end that need no mapping."""
KEYS = {
    "angle": ("track", "unit", "sign", "zero", "gear", "range", "ends", "wrap"),
    "target": ("track", "unit", "sign", "zero", "gear", "range", "ends", "wrap"),
    "torque": ("track", "unit", "sign", "gear", "constant", "offset", "feedforward"),
}


@dataclass(frozen=True)
class Source:
    """A track and what makes SI units of its values: (value − origin) · factor + offset.

    `unit` is the declared one, if any. `gear` is part of the factor already, as a range is. The
    track's values are known modulo `wrap`, if that is not 0: each is taken within half of it of the one before.
    `feedforward`: a torque that a controller adds to its servo's. `added` are other tracks whose SI units are added.
    """

    track: str
    factor: float = 1.0
    offset: float = 0.0
    unit: str | None = None
    origin: float = 0.0
    gear: float = 1.0
    wrap: float = 0.0
    feedforward: bool = False
    added: tuple["Source", ...] = ()

    def of(self, episode: Episode, where: str) -> Track:
        """The track in SI units. Raises InputError where the log has none of that name, or without times."""
        found = track(episode, self.track, where)
        if not len(found.time):
            raise InputError(f"{where}: no row of track {self.track!r} has a time")
        values, known = found.values, np.isfinite(found.values)
        if self.wrap:
            values = values.copy()
            values[known] = np.unwrap(values[known], period=self.wrap)
        values = (values - self.origin) * self.factor + self.offset
        return Track(found.time, sum((each.of(episode, where).last_before(found.time) for each in self.added), values))

    def times(self, factor: float) -> "Source":
        """The source in another unit: values ``factor`` times as large, about the same zero."""
        added = tuple(each.times(factor) for each in self.added)
        return replace(self, factor=self.factor * factor, added=added)


@dataclass(frozen=True)
class JointMap:
    """Where a joint's angle, torque and target come from; None for what the log lacks."""

    angle: Source | None = None
    torque: Source | None = None
    target: Source | None = None


@dataclass(frozen=True)
class LogMap:
    """A whole mapping: joints by name, the column of times, the seconds of its unit, and the declared units.

    `units` have an angle where all angles have a unit, and a time where there is a `time_unit`: what is only taken for
    radians or seconds is not declared.
    """

    joints: Mapping[str, JointMap] = field(default_factory=dict)
    time: str | None = None
    second: float = 1.0
    units: Units = field(default_factory=lambda: Units(mapping="a mapping (--map)"))

    def needed(self) -> Needed:
        """The tracks that it names."""
        sources = [source for joint in self.joints.values() for source in (joint.angle, joint.torque, joint.target)]
        return Needed(frozenset(each.track for source in sources if source for each in (source, *source.added)))

    def rescaled(self, angle: float = 1.0, target: float = 1.0, time: float = 1.0) -> "LogMap":
        """The mapping in other units: angles, targets and times so many times as large, about the same zeros."""

        def of(joint: JointMap) -> JointMap:
            return replace(
                joint,
                angle=None if joint.angle is None else joint.angle.times(angle),
                target=None if joint.target is None else joint.target.times(target),
            )

        joints = {name: of(joint) for name, joint in self.joints.items()}
        return replace(self, joints=joints, second=self.second * time)

    def check_kinds(self, slides: Collection[str]) -> None:
        """Raise InputError for an angle or target in a unit of length of a joint that turns, or the other way round.

        ``slides`` are the names of the joints that shift; their numbers are in m by default.
        """
        for name, joint in self.joints.items():
            known, what = (SHIFTS, "shifts") if name in slides else (ANGLES, "turns")
            for kind, source in (("angle", joint.angle), ("target", joint.target)):
                for each in (source, *source.added) if source else ():
                    if each.unit is not None and each.unit not in known:
                        raise InputError(
                            f"joints.{name}.{kind}: the joint {what}: expected a unit of {', '.join(known)}, "
                            f"got {each.unit!r}"
                        )

    @classmethod
    def load(cls, path: str | Path) -> "LogMap":
        """Read a mapping. Raises InputError for another kind of file, OSError where it cannot be read."""
        with about(path):
            found = cls.of(read_toml(path, "a mapping"), Path(path).parent)
        return replace(found, units=replace(found.units, mapping=str(path)))

    @classmethod
    def of(cls, tables: dict[str, Any], folder: Path = Path()) -> "LogMap":
        """The mapping of such a file's tables, which names other files as from its ``folder``. Raises InputError."""
        _known(tables, ("time", "time_unit", "joints"), "a mapping")
        unit = tables.get("time_unit", "s")
        if not isinstance(unit, str) or unit not in TIMES:
            raise InputError(f"time_unit: expected one of {', '.join(TIMES)}, got {unit!r:.40}")
        if not isinstance(time := tables.get("time"), str | None):
            raise InputError(f"time: expected the name of a column, got {time!r:.40}")
        joints = tables.get("joints")
        if not isinstance(joints, dict) or not joints:
            raise InputError("expected tables [joints.NAME], one for each joint, got none")
        found = {}
        for name, table in joints.items():
            if not isinstance(table, dict):
                raise InputError(f"joints.{name}: expected a table with {', '.join(KEYS)}")
            _known(table, tuple(KEYS), f"joints.{name}")
            found[name] = JointMap(
                **{kind: _source(table[kind], kind, f"joints.{name}.{kind}", folder) for kind in table}
            )
        given = [table["angle"] for table in joints.values() if "angle" in table]
        angles = [each for own in given for each in (own if isinstance(own, list) else [own])]
        own = cls(found, time, TIMES[unit])
        every = all(isinstance(each, dict) and ("unit" in each or "range" in each) for each in angles)
        declared = {"angle": "rad" if every else None, "time": unit if "time_unit" in tables else None}
        return replace(own, units=replace(own.units, **declared))

    @classmethod
    def by_name(cls, episode: Episode, joints: Sequence[str]) -> "LogMap":
        """A mapping by the tracks' own names, as ROS's JointState has them; targets are not measurements.

        Raises InputError for a joint without such a track, and for one with two.
        """

        def named(joint: str, kind: str) -> Source | None:
            found = [n for n in episode if n.endswith(f".{joint}.{BY_NAME[kind]}") and not episode[n].target]
            if len(found) > 1:
                raise InputError(
                    f"the {kind} of joint {joint!r} is in {len(found)} tracks, {found[0]!r} and {found[1]!r}: say "
                    f'which by --map, [joints.{joint}] {kind} = "{found[0]}"'
                )
            return Source(found[0]) if found else None

        found = {joint: JointMap(named(joint, "angle"), named(joint, "torque")) for joint in joints}
        if missing := [joint for joint, own in found.items() if own.angle is None]:
            known = ", ".join(list(episode)[:12])
            raise InputError(
                f"no track says by its name that it is the angle of {missing[0]!r} (it has {known}): --map"
            )
        return cls(found)


def _source(given: Any, kind: str, where: str, folder: Path) -> Source:
    if isinstance(given, list) and given and not any(isinstance(each, list) for each in given):
        first, *others = (_source(each, kind, where, folder) for each in given)
        return replace(first, added=tuple(others))
    table = {"track": given} if isinstance(given, str) else given
    if not isinstance(table, dict) or not isinstance(table.get("track"), str):
        raise InputError(f'{where}: expected {{track = "NAME", …}}, got {given!r:.60}')
    _known(table, KEYS[kind], where)

    numbers = {key: table[key] for key in ("sign", "zero", "gear", "constant", "offset") if key in table}
    for key, value in numbers.items():
        if not _is_number(value):
            raise InputError(f"{where}: expected {key} as a number, got {value!r:.40}")
    if numbers.get("sign", 1) not in (1, -1):
        raise InputError(f"{where}: expected sign as 1 or -1, got {numbers['sign']:g}")

    gear = float(numbers.get("gear", 1.0))
    if gear == 0:
        raise InputError(f"{where}: expected a gear other than 0: leave it out for a motor at its joint")
    units = TORQUES if kind == "torque" else {**ANGLES, **SHIFTS}
    unit = table.get("unit", "N·m" if kind == "torque" else "rad")
    if not isinstance(unit, str) or unit not in units:
        raise InputError(f"{where}: unit: expected one of {', '.join(units)}, got {unit!r:.40}")

    slope, origin = _of_range(table, where, folder)
    factor = units[unit] * numbers.get("sign", 1) * numbers.get("constant", 1.0) * slope
    factor = factor * gear if kind == "torque" else factor / gear
    if not np.isfinite([factor, origin]).all():
        raise InputError(f"{where}: expected numbers of a usual size, got a factor of {factor:g}")
    wrap = table.get("wrap", 0.0)
    if "wrap" in table and not (_is_number(wrap) and wrap > 0):
        raise InputError(
            f"{where}: expected wrap as the positive number at which the angle starts again, got {wrap!r:.40}"
        )
    if not isinstance(forward := table.get("feedforward", False), bool):
        raise InputError(f"{where}: expected feedforward as true or false, got {forward!r:.40}")
    zero = float(numbers.get("zero", numbers.get("offset", 0.0)))
    return Source(table["track"], float(factor), zero, table.get("unit"), origin, gear, float(wrap), forward)


def _of_range(table: dict[str, Any], where: str, folder: Path) -> tuple[float, float]:
    """Movement of a joint in its range per unit of a value, in the range's unit, and the value at which it is 0."""
    if "range" not in table:
        if "ends" in table:
            raise InputError(f"{where}: ends are of a range: write range = [low, high], too")
        return 1.0, 0.0
    given = table["range"]
    if isinstance(given, str):
        if table.get("unit", "rad") != "rad":
            raise InputError(f"{where}: a calibration's range is in rad, got unit {table['unit']!r}: leave unit out")
        given = calibrated_range(folder / given, table["track"], where)
    (low, high), (first, last) = _pair(given, f"{where}: range"), _pair(table.get("ends", ENDS), f"{where}: ends")
    slope = (high - low) / (last - first)
    if slope == 0:
        raise InputError(f"{where}: expected a range of a usual size, got {given!r:.60}")
    return slope, first - low / slope


def _pair(given: Any, where: str) -> tuple[float, float]:
    """Two numbers that differ. Raises InputError."""
    if (
        not isinstance(given, list | tuple)
        or len(given) != 2
        or not all(map(_is_number, given))
        or given[0] == given[1]
    ):
        raise InputError(f"{where}: expected two numbers that differ, such as [-1.9, 1.7], got {given!r:.60}")
    return float(given[0]), float(given[1])


def _is_number(value: Any) -> bool:
    """Whether a value of a TOML file is a finite number."""
    return not isinstance(value, bool) and isinstance(value, int | float) and abs(value) <= sys.float_info.max


def _known(table: dict[str, Any], keys: Sequence[str], where: str) -> None:
    if strange := [key for key in table if key not in keys]:
        raise InputError(f"{where}: unknown key {strange[0]!r:.40}; known are {', '.join(keys)}")
