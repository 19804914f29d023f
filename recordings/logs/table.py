"""Tables: one row a sample, a column a track; the column of times is "time", unless a mapping names another."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..tables import check_lengths, check_once, header_and_rows, read_numbers
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
