"""Tables: one row a sample, a column a track; the time's column is "time", unless a mapping says another."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..tables import Columns
from .tracks import Episode, Needed, Track


def read_csv(path: Path, time: str | None = None, tracks: Needed | None = None) -> list[Episode]:
    """The columns of a CSV file, each read when it is looked up. Raises InputError for one without a column of times.

    Raises InputError at a look-up for a column that holds no numbers.
    """
    columns = Columns(path)
    name = time or "time"
    if name not in columns:
        raise InputError(f"{path}: no column {name!r} for the time; it has {', '.join(list(columns)[:20])}")
    return [_Tracks(columns, name, columns[name])]


class _Tracks(Mapping[str, Track]):
    """A table's columns over the times in one of them."""

    def __init__(self, columns: Columns, clock: str, time: np.ndarray) -> None:
        self._columns, self._clock, self._time = columns, clock, time

    def __getitem__(self, name: str) -> Track:
        if name == self._clock:
            raise KeyError(name)
        return Track.of(self._time, self._columns[name])

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._columns if name != self._clock)

    def __len__(self) -> int:
        return len(self._columns) - 1
