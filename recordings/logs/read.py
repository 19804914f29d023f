"""One call from a log of any kind to recordings, an episode each, in SI units and the robot's own angles.

Of a table a row is a sample and a column a track; that of times is "time", unless a mapping names another.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..joined import SAME_TIME
from ..recording import Recording
from ..tables import check_lengths, check_once, header_and_rows, read_numbers
from .lerobot import read_lerobot
from .mapping import BY_NAME, LogMap, Source
from .mcap_file import read_mcap
from .ros_bag import read_bag
from .tracks import Episode, Needed, Track


def read_csv(path: Path, time: str | None = None, tracks: Needed | None = None) -> list[Episode]:
    """The columns of a CSV file, each converted to numbers when it is looked up.

    Raises InputError for a file without a column of times, and at a look-up for a column that holds no numbers.
    """
    return [_Tracks(path, time or "time")]


class _Tracks(Mapping[str, Track]):
    """A table's columns that have a name, over the times in one of them."""

    def __init__(self, path: Path, clock: str) -> None:
        self._path = path
        self._header, self._rows = header_and_rows(path)
        self._names = [name for name in dict.fromkeys(self._header) if name not in ("", clock)]
        with about(path):
            check_lengths(self._rows, self._header)
            if clock not in self._header:
                raise InputError(f"no column {clock!r} for the time; it has {', '.join(self._names[:20])}")
        self._time = self._column(clock)

    def _column(self, name: str) -> np.ndarray:
        place = self._header.index(name)
        with about(self._path):
            check_once(self._header, [name])
            return read_numbers([(line, [cells[place]]) for line, cells in self._rows], [name])[0][:, 0]

    def __getitem__(self, name: str) -> Track:
        if name not in self._names:
            raise KeyError(name)
        return Track.of(self._time, self._column(name))

    def __contains__(self, name: object) -> bool:
        return name in self._names  # a Mapping's own would convert the column

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


LOG_FORMATS: dict[str, Callable[[Path, str | None, Needed | None], list[Episode]]] = {
    "csv": read_csv,
    "lerobot": read_lerobot,
    "mcap": read_mcap,
    "ros2": read_bag,
}


MAX_PAUSE = 1e7
"""Usual steps between two rows, at most: 55 h at 50 rows/s."""


@dataclass(frozen=True)
class Logged:
    """An episode's recording, and the targets (T, K) of its joints, NaN where there are none."""

    recording: Recording
    targets: np.ndarray

    def without_commands(self) -> "Logged":
        """The angles alone."""
        return Logged(replace(self.recording, torques=None), np.full_like(self.targets, np.nan))


def kind_of(path: Path) -> str | None:
    """The kind of log that a path is by its suffix, or by what lies in a folder; None for none that is known."""
    if path.is_dir():
        return "ros2" if (path / "metadata.yaml").is_file() else "lerobot" if (path / "meta").is_dir() else None
    return {".csv": "csv", ".parquet": "lerobot", ".mcap": "mcap", ".db3": "ros2"}.get(path.suffix)


def read_log(path: str | Path, time: str | None = None, needed: Needed | None = None) -> list[Episode]:
    """A log's tracks, ``time`` by the column of that name; of tracks that are not ``needed`` the names alone.

    Raises InputError for a kind that is not known or one that costs more than its budget (:mod:`..budget`), OSError
    where it cannot be read.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(2, "no such log", str(path))
    if (kind := kind_of(path)) is None:
        raise InputError(
            f"{path}: expected a log: .csv, .mcap, .parquet, the folder of a ROS 2 bag or of a LeRobot data set"
        )
    return LOG_FORMATS[kind](path.parent if path.suffix == ".db3" else path, time, needed)


def recordings_of(
    path: str | Path,
    joints: Sequence[str],
    mapping: LogMap | None = None,
    episodes: Sequence[int] | None = None,
    **scales: float,
) -> list[Logged]:
    """A log's episodes as recordings of ``joints``; all of them, or those of the numbers given.

    Rows are all times at which an angle or a command was logged; commands stay constant, and an angle stays missing in
    a row that has none of its own. ``scales`` are :meth:`.LogMap.rescaled`'s, of units other than the mapping's.
    Raises InputError for a log that is none, and tracks or episodes that it lacks.
    """
    needed = Needed(ends=tuple(f".{j}.{end}" for j in joints for end in BY_NAME.values()))
    found = read_log(path, None if mapping is None else mapping.time, needed if mapping is None else mapping.needed())
    chosen = range(len(found)) if episodes is None else episodes
    if beyond := [number for number in chosen if not 0 <= number < len(found)]:
        raise InputError(f"{path}: no episode {beyond[0]}; it has {len(found)}, from 0 on")
    with about(path):
        name = Path(path).stem
        titles = {n: name if len(found) == 1 else f"{name} {n}" for n in chosen}
        maps = {n: (mapping or LogMap.by_name(found[n], joints)).rescaled(**scales) for n in chosen}
        return [_recording(found[n], joints, maps[n], titles[n]) for n in chosen]


def _recording(episode: Episode, joints: Sequence[str], mapping: LogMap, name: str) -> Logged:
    if strange := [joint for joint in mapping.joints if joint not in joints]:
        raise InputError(f"the mapping has joint {strange[0]!r}, the robot has {', '.join(joints)}")

    def tracks(kind: str) -> list[Track | None]:
        sources: list[Source | None] = [getattr(mapping.joints.get(joint), kind, None) for joint in joints]
        return [None if source is None else source.of(episode, kind) for source in sources]

    angles, torques, targets = tracks("angle"), tracks("torque"), tracks("target")
    if all(each is None for each in angles):
        raise InputError("expected angles of the joints, the mapping names none")
    rows = np.unique(np.concatenate([each.time for each in (*angles, *torques, *targets) if each is not None]))
    rows = rows[np.append(True, np.diff(rows) > SAME_TIME)]
    _check_pause(rows)
    commands = [each for each in (*torques, *targets) if each is not None]
    # before the first command the torque is unknown
    begin = max((float(each.time[0]) for each in commands), default=rows[0])
    rows = rows[rows >= begin - SAME_TIME]
    nothing = np.full(len(rows), np.nan)

    def columns(found: list[Track | None], last: bool) -> np.ndarray:
        made = [nothing if t is None else t.last_before(rows + SAME_TIME) if last else _near(t, rows) for t in found]
        return np.stack(made, -1)

    recording = Recording(
        rows * mapping.second,
        np.empty((len(rows), 0, 2)),
        (),
        angles=columns(angles, False),
        torques=columns(torques, True) if any(t is not None for t in torques) else None,
        joint_names=tuple(joints),
        name=name,
    )
    return Logged(recording, columns(targets, True))


def _check_pause(rows: np.ndarray) -> None:
    """Raise InputError where times (N,) jump as no log's do: two clocks, or a time that is none."""
    steps = np.diff(rows)
    if len(steps) and steps.max() > MAX_PAUSE * (usual := float(np.median(steps))):
        at = int(steps.argmax())
        raise InputError(
            f"its times jump from {rows[at]:.6g} to {rows[at + 1]:.6g}, in usual steps of {usual:.3g}: expected one "
            "clock and no such pause; leave out the topic or the rows with other times"
        )


def _near(each: Track, rows: np.ndarray) -> np.ndarray:
    """The values of a track in the rows that are its own."""
    place = np.searchsorted(each.time, rows - SAME_TIME).clip(0, len(each.time) - 1)
    return np.where(np.abs(each.time[place] - rows) <= SAME_TIME, each.values[place], np.nan)
