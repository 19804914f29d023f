"""Known forces on keypoints, from a table with a clock of its own.

A header, then one row a sample: `time` in s, and `<keypoint>_fx`, `<keypoint>_fy` (and `_fz` in space) in N, in the
recording's frame, as they act on the body.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import InputError, about
from .naming import closest
from .recording import check_range, check_time
from .tables import read_table

AXES = ("fx", "fy", "fz")


@dataclass(frozen=True, eq=False)
class SiteForce:
    """A force on a keypoint: `time` (N,) s and `force` (N, d) N, a straight line between samples.

    Raises InputError for shapes that do not fit, times that do not increase, and forces that are missing.
    """

    keypoint: str
    time: np.ndarray
    force: np.ndarray

    def __post_init__(self) -> None:
        for name in ("time", "force"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        if self.time.ndim != 1 or self.force.shape not in ((len(self.time), 2), (len(self.time), 3)):
            raise InputError(
                f"force on {self.keypoint}: expected times (N,) and forces (N, 2) or (N, 3), got {self.time.shape} and "
                f"{self.force.shape}"
            )
        check_time(self.time, "sample {}".format)
        check_range(f"force on {self.keypoint}", self.force, "sample {}".format)
        if not np.isfinite(self.force).all():
            raise InputError(f"force on {self.keypoint}: expected a number in each sample, got an empty one: write 0")

    def check(self, keypoints: Sequence[str], time: np.ndarray, dimensions: int) -> None:
        """Raise InputError unless it acts on one of ``keypoints`` at all times (T,) of a body of those dimensions."""
        if self.keypoint not in keypoints:
            known = ", ".join(keypoints)
            raise InputError(
                f"force on {self.keypoint!r}, which is no keypoint of the body, which has {known}"
                f"{closest(self.keypoint, keypoints)}"
            )
        if self.force.shape[1] != dimensions:
            raise InputError(f"force on {self.keypoint}: expected {dimensions} components, got {self.force.shape[1]}")
        step = float(np.median(np.diff(time)))
        if self.time[0] > time[0] + step or self.time[-1] < time[-1] - step:
            raise InputError(
                f"force on {self.keypoint} is known from {self.time[0]:g} to {self.time[-1]:g} s, and the recording "
                f"lasts from {time[0]:g} to {time[-1]:g} s: use its rows alone (--frames), or check both clocks"
            )


def read_forces(path: str | Path) -> list[SiteForce]:
    """The forces in a file. Raises InputError for what is no such table, OSError for a file that cannot be opened."""
    columns, _ = read_table(path)
    with about(path):
        if next(iter(columns), None) != "time" or len(columns) < 3:
            raise InputError(f"expected columns time, <keypoint>_fx, <keypoint>_fy, got {', '.join(columns)}")
        time = columns.pop("time")
        found: dict[str, dict[str, np.ndarray]] = {}
        for label, column in columns.items():
            name, _, axis = label.rpartition("_")
            if axis not in AXES or not name:
                raise InputError(f"expected columns <keypoint>_fx, _fy and _fz, got {label!r}")
            found.setdefault(name, {})[axis] = column
        for name, own in found.items():
            if tuple(own) not in (AXES[:2], AXES):
                raise InputError(f"force on {name}: expected {', '.join(AXES[:2])} (and fz), got {', '.join(own)}")
        return [SiteForce(name, time, np.stack([*own.values()], -1)) for name, own in found.items()]
