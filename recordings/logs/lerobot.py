"""LeRobot data sets (Cadene et al., LeRobot; data set formats v2 and v3): parquet files, an episode after the other.

A row has "episode_index", "timestamp" (s from the episode's start) and features that are lists of numbers, such as
"observation.state" and "action". Their entries are called "observation.state.0", or by the names that meta/info.json
gives: "observation.state.elbow.pos". The format does not state the meaning of the numbers (degrees, a range of −100 to
100).

Columns that are needed are read, and of the others the names. How many numbers they hold is known before any is
unpacked: a few bytes of parquet may stand for gigabytes.

A motor's range from the calibration that LeRobot keeps of a robot: a .json file.

    {"elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 12, "range_min": 900, "range_max": 3100}, …}

Feetech's STS and Dynamixel's X motors, which its arms have, count 4096 ticks a revolution. LeRobot scales a tick t
between `range_min` and `range_max` to −100 … 100, of a gripper to 0 … 100, and takes both the other way round where
`drive_mode` is 1 (`lerobot/motors/motors_bus.py`, `_normalize`). The middle of the range is its zero. So the range is

    ± π (range_max − range_min)/4096 rad,     low > high where drive_mode is 1.
"""

import json
from collections import Counter
from collections.abc import Sequence
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from ..budget import Budget, read_document
from ..errors import InputError, about, readable
from ..limits import LIMITS
from ..paths import check_readable
from .tracks import Episode, Needed, Track, needed

INDEX, CLOCK = "episode_index", "timestamp"
OURS = {INDEX, CLOCK, "frame_index", "index", "task_index"}
BATCH_ROWS = 2**14
"""Rows that are unpacked at a time."""


def read_lerobot(path: Path, time: str | None = None, tracks: Needed | None = None) -> list[Episode]:
    """Episodes of a data set's folder, or of one parquet file of it.

    Raises InputError for another kind of file or one beyond the budget, OSError for a file that cannot be opened.
    """
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(f"{path}: {needed('pyarrow', 'parquet')}") from error
    root = path if path.is_dir() else next((p for p in path.parents if (p / "meta" / "info.json").is_file()), None)
    files = sorted(path.glob("data/**/*.parquet")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: expected a LeRobot data set, with data/…/*.parquet in it")
    called = {} if root is None else _names(root / "meta" / "info.json")
    clock, budget = time or CLOCK, Budget(sum(check_readable(file).stat().st_size for file in files))

    episodes: dict[float, dict[str, list[np.ndarray]]] = {}
    for file in files:
        with readable(file, "a parquet file"), pyarrow.parquet.ParquetFile(file) as parquet:
            columns = _columns(parquet, {INDEX, clock}, tracks, called, budget)
            names = parquet.schema_arrow.names
            rows = parquet.metadata.num_rows
        if clock not in columns:
            raise InputError(f"{file}: no column of numbers {clock!r}; it has {', '.join(names[:20])}")
        index = columns.get(INDEX, np.full(rows, np.nan if INDEX in names else 0.0))
        if not np.isfinite(index).all():
            raise InputError(f"{file}: expected the number of an episode in each row of {INDEX!r}")
        for episode in np.unique(index).tolist():
            chosen, own = index == episode, episodes.setdefault(episode, {})
            for name, values in columns.items():
                own.setdefault(name, []).append(values[chosen] if len(values) else values)
    with about(path):
        return [_episode(each, clock) for _, each in sorted(episodes.items())]


def _episode(columns: dict[str, list[np.ndarray]], clock: str) -> Episode:
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    time = whole[clock]
    if partly := [name for name, values in whole.items() if len(values) not in (0, len(time))]:
        raise InputError(f"expected {partly[0]!r} in all of its files, it is in some alone")
    return {
        name: Track.of(time if len(values) else values, values)
        for name, values in whole.items()
        if name not in OURS | {clock}
    }


def _columns(
    parquet: Any, own: set[str], tracks: Needed | None, called: dict[str, Sequence[str]], budget: Budget
) -> dict[str, np.ndarray]:
    """Numbers (rows,) of the columns that are needed, by the names of their entries; of the others none.

    Columns of words, booleans and nested lists are skipped.
    """
    from pyarrow import types

    found: dict[str, np.ndarray] = {}
    lists: list[str] = []
    single: list[str] = []
    for column in parquet.schema_arrow:
        listed = types.is_list(column.type) or types.is_large_list(column.type) or types.is_fixed_size_list(column.type)
        kind = column.type.value_type if listed else column.type
        if not (types.is_integer(kind) or types.is_floating(kind)):
            continue
        entries = [f"{column.name}.{label}" for label in called.get(column.name, ())]
        if column.name in own or tracks is None or tracks.source(column.name):
            (lists if listed else single).append(column.name)
        else:
            found |= dict.fromkeys(entries or [column.name], np.empty(0))

    _check_numbers(parquet, [*single, *lists], budget)
    parts: dict[str, list[Any]] = {name: [] for name in (*single, *lists)}
    if parts:
        for batch in parquet.iter_batches(BATCH_ROWS, columns=list(parts), use_threads=False):
            for name, taken in parts.items():
                taken.append(_lists(batch[name]) if name in lists else (_numbers(batch[name]),))

    for name in single:
        found[name] = np.concatenate([part[0] for part in parts[name]] or [np.empty(0)])
    for name in lists:
        lengths = np.concatenate([np.empty(0, np.int64), *(part[0] for part in parts[name])])
        numbers = np.concatenate([np.empty(0), *(part[1] for part in parts[name])])
        found |= _entries(name, lengths, numbers, called.get(name, ()), budget)
    return found


def _check_numbers(parquet: Any, names: Sequence[str], budget: Budget) -> None:
    """Take the numbers of those columns from the budget, as the file states them."""
    for group in range(parquet.metadata.num_row_groups):
        stated = parquet.metadata.row_group(group)
        for number in range(stated.num_columns):
            column = stated.column(number)
            if any(column.path_in_schema == name or column.path_in_schema.startswith(f"{name}.") for name in names):
                budget.count(column.num_values)


def _numbers(column: Any) -> np.ndarray:
    return column.cast("float64", safe=False).to_numpy(zero_copy_only=False)


def _lists(column: Any) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (rows,) of a column of lists, 0 where there is none, and all their numbers."""
    from pyarrow import compute

    lengths = compute.fill_null(compute.list_value_length(column), 0).to_numpy(zero_copy_only=False)
    return lengths.astype(np.int64), _numbers(compute.list_flatten(column))


def _entries(
    name: str, lengths: np.ndarray, numbers: np.ndarray, labels: Sequence[str], budget: Budget
) -> dict[str, np.ndarray]:
    """Entries of a feature, (rows,) each, NaN in rows of another length than most; empty rows have none."""
    sizes, counts = np.unique(lengths[lengths > 0], return_counts=True)
    size = len(labels) if len(labels) in sizes else int(sizes[counts.argmax()]) if len(sizes) else 0
    budget.count(size * len(lengths) - len(numbers))

    whole = lengths == size
    starts = (np.cumsum(lengths) - lengths)[whole]
    rows = np.full((len(lengths), size), np.nan)
    rows[whole] = numbers[starts[:, None] + np.arange(size)]

    called = labels if len(labels) == size else [str(k) for k in range(size)]
    if twice := [label for label, count in Counter(called).items() if count > 1]:
        raise InputError(f"two entries of {name!r} are called {twice[0]!r:.60} in meta/info.json: rename one of them")
    return {f"{name}.{label}": rows[:, k] for k, label in enumerate(called)}


def _names(info: Path) -> dict[str, Sequence[str]]:
    """Names of the entries of each feature that has some."""
    try:
        features = json.loads(read_document(info)).get("features", {})
    except (OSError, ValueError, AttributeError, RecursionError):
        return {}
    found: dict[str, Sequence[str]] = {}
    for feature, described in features.items() if isinstance(features, dict) else ():
        names = described.get("names") if isinstance(described, dict) else None
        if isinstance(names, dict):  # {"motors": […]}
            names = next((v for v in names.values() if isinstance(v, list)), None)
        if isinstance(names, list) and all(isinstance(name, str) for name in names):
            found[feature] = names
    return found


TICKS = 4096  # of a revolution


def calibrated_range(path: Path, track: str, where: str) -> tuple[float, float]:
    """Range, rad about its middle, of the motor in the name of ``track``: "observation.state.elbow_flex.pos".

    Raises InputError for another file, or a track whose name has none of its motors' or several; OSError where it
    cannot be read.
    """
    motors = _motors(path, where)
    named = [motor for motor in motors if motor in track.split(".")]
    if len(named) != 1:
        raise InputError(
            f"{where}: expected the name of one motor of {path.name} in the track {track!r}, "
            f"got {len(named)}; it has {', '.join(list(motors)[:12])}: write range = [low, high]"
        )
    own = motors[named[0]]
    first, last = (own.get(key) if isinstance(own, dict) else None for key in ("range_min", "range_max"))
    if not (isinstance(first, int) and isinstance(last, int) and 0 < abs(last - first) <= TICKS * TICKS):
        raise InputError(
            f"{where}: {path.name}: {named[0]}: expected range_min and range_max in ticks, got {first!r:.40} and "
            f"{last!r:.40}"
        )
    half = pi * (last - first) / TICKS * (-1 if own.get("drive_mode") else 1)
    return -half, half


def _motors(path: Path, where: str) -> dict[str, Any]:
    """Table of each motor in a calibration."""
    if not path.is_file():
        raise InputError(f"{where}: no calibration {path}: expected LeRobot's .json, or range = [low, high]")
    text = read_document(path, LIMITS.yaml)
    try:
        motors = json.loads(text)
    except (ValueError, RecursionError):
        motors = None
    if not isinstance(motors, dict) or not motors:
        raise InputError(f"{where}: {path}: expected LeRobot's calibration, a table of motors in JSON")
    return motors
