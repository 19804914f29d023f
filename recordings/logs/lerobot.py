"""LeRobot data sets (Cadene et al., LeRobot; data set formats v2 and v3): parquet files, an episode after the other.

A row has "episode_index", "timestamp" (s from the episode's start) and features that are lists of numbers, such as
"observation.state" and "action". Their entries are called "observation.state.0", or by the names that meta/info.json
gives: "observation.state.elbow.pos". What their numbers mean (degrees, a range of −100 to 100) the format does not say.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, about
from .tracks import Episode, Track, needed

INDEX, CLOCK = "episode_index", "timestamp"
OURS = {INDEX, CLOCK, "frame_index", "index", "task_index"}


def read_lerobot(path: Path, time: str | None = None) -> list[Episode]:
    """Episodes of a data set's folder, or of one parquet file of it. Raises InputError for what is none."""
    try:
        import pyarrow.parquet
    except ImportError as error:
        raise InputError(f"{path}: {needed('pyarrow', 'parquet')}") from error
    root = path if path.is_dir() else next((p for p in path.parents if (p / "meta" / "info.json").is_file()), None)
    files = sorted(path.glob("data/**/*.parquet")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: expected a LeRobot data set, with data/…/*.parquet in it")
    called = {} if root is None else _names(root / "meta" / "info.json")
    episodes: dict[float, dict[str, list[np.ndarray]]] = {}
    for file in files:
        try:
            table = pyarrow.parquet.read_table(file)
        except (pyarrow.ArrowException, OSError) as error:
            raise InputError(f"{file}: no parquet file that can be read: {str(error).splitlines()[0]}") from error
        clock = time or CLOCK
        columns = {name: values for n in table.column_names for name, values in _columns(n, table[n], called).items()}
        if clock not in columns:
            raise InputError(f"{file}: no column of numbers {clock!r}; it has {', '.join(table.column_names[:20])}")
        index = columns.get(INDEX, np.full(len(table), np.nan if INDEX in table.column_names else 0.0))
        if not np.isfinite(index).all():
            raise InputError(f"{file}: expected the number of an episode in each row of {INDEX!r}")
        for episode in np.unique(index).tolist():
            rows, own = index == episode, episodes.setdefault(episode, {})
            for name, values in columns.items():
                own.setdefault(name, []).append(values[rows])
    with about(path):
        return [_episode(each, time or CLOCK) for _, each in sorted(episodes.items())]


def _episode(columns: dict[str, list[np.ndarray]], clock: str) -> Episode:
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    if partly := [name for name, values in whole.items() if len(values) != len(whole[clock])]:
        raise InputError(f"expected {partly[0]!r} in all of its files, it is in some alone")
    return {name: Track.of(whole[clock], values) for name, values in whole.items() if name not in OURS | {clock}}


def _columns(name: str, column: Any, called: dict[str, Sequence[str]]) -> dict[str, np.ndarray]:
    """A feature's numbers by the names of its entries; nothing of what is no numbers."""
    values = column.to_pylist()
    first = next((value for value in values if value is not None), None)
    if isinstance(first, list):
        if not all(isinstance(each, int | float) for each in first):
            return {}
        size = len(first)
        rows = np.array([[np.nan] * size if v is None or len(v) != size else v for v in values], dtype=np.float64)
        names = called.get(name, ())
        labels = names if len(names) == size else [str(k) for k in range(size)]
        return {f"{name}.{label}": rows[:, k] for k, label in enumerate(labels)}
    if isinstance(first, int | float):
        return {name: np.array([np.nan if v is None else v for v in values], dtype=np.float64)}
    return {}


def _names(info: Path) -> dict[str, Sequence[str]]:
    """Names of the entries of each feature that has some."""
    try:
        features = json.loads(info.read_text(encoding="utf-8")).get("features", {})
    except (OSError, ValueError, AttributeError, RecursionError):
        return {}
    found: dict[str, Sequence[str]] = {}
    for feature, told in features.items() if isinstance(features, dict) else ():
        names = told.get("names") if isinstance(told, dict) else None
        if isinstance(names, dict):  # {"motors": […]}
            names = next((v for v in names.values() if isinstance(v, list)), None)
        if isinstance(names, list) and all(isinstance(name, str) for name in names):
            found[feature] = names
    return found
