"""A log of any kind: named tracks of numbers, each at times of its own, in one or several episodes.

Units and names are the file's. Duplicate rows are kept once, rows out of order are sorted, and missing rows stay
missing.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import InputError


@dataclass(frozen=True, eq=False)
class Track:
    """Values (N,) at times (N,) s, increasing; `target` for a controller's targets, which are not measured."""

    time: np.ndarray
    values: np.ndarray
    target: bool = False

    @classmethod
    def of(cls, time: np.ndarray, values: np.ndarray, target: bool = False) -> "Track":
        """A track of rows in any order, of which several may have one time: the first of those counts."""
        time, values = np.asarray(time, dtype=np.float64), np.asarray(values, dtype=np.float64)
        use = np.isfinite(time)
        kept, first = np.unique(time[use], return_index=True)
        return cls(kept, values[use][first], target)

    def last_before(self, time: np.ndarray) -> np.ndarray:
        """The last value at or before each time, NaN before the first."""
        known = np.isfinite(self.values)
        at = np.searchsorted(self.time[known], time, side="right") - 1
        return np.where(at >= 0, self.values[known][np.maximum(at, 0)] if known.any() else np.nan, np.nan)

    def at(self, time: np.ndarray) -> np.ndarray:
        """The values at those of ``time`` that the track has, NaN at the others."""
        place = np.searchsorted(self.time, time).clip(0, len(self.time) - 1)
        return np.where(np.isclose(self.time[place], time, rtol=0, atol=1e-9), self.values[place], np.nan)


Episode = Mapping[str, Track]
"""Tracks by name."""


@dataclass(frozen=True)
class Needed:
    """Which tracks are read: those of a mapping, and those whose names end in one of `ends`.

    Of what is not needed a reader gives the names, where it can, and no numbers.
    """

    tracks: frozenset[str] = frozenset()
    ends: tuple[str, ...] = ()

    def track(self, name: str) -> bool:
        """Whether the track of that name is needed."""
        return name in self.tracks or name.endswith(self.ends)

    def source(self, name: str) -> bool:
        """Whether a topic or column, whose tracks are called "NAME" or "NAME.…", may have one that is needed."""
        return bool(self.ends) or name in self.tracks or any(each.startswith(f"{name}.") for each in self.tracks)


def track(episode: Episode, name: str, where: str) -> Track:
    """The track of that name; raises InputError, which lists those that are there."""
    if name not in episode:
        known = ", ".join(list(episode)[:20]) + (" …" if len(episode) > 20 else "")
        raise InputError(f"{where}: no track {name!r}; the log has {known or 'none'}")
    return episode[name]


def needed(module: str, what: str) -> str:
    """The message where a package that reads ``what`` is missing."""
    return f"{what} needs the package {module}: pip install 'invdyn[logs]'"
