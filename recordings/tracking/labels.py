"""Labels: where the joints are in some of a film's pictures, in px (u right, v down), as people or trackers put them.

Our own table has one row a picture, an empty cell for a joint that cannot be seen:

    frame,<keypoint>_x,<keypoint>_y, …

DeepLabCut's labels (`CollectedData_….csv`: the number in an image's name is the picture's) and tracks, SLEAP's analysis
csv and all that `formats` reads as pixels are read as well.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..formats.deeplabcut import LEVELS, assembled
from ..formats.registry import FORMATS, recognise
from ..recording import Recording
from ..tables import Row, read_numbers, read_rows, read_table, write_table

MAX_NUMBER = 2**53
"""Below it a float64 represents every whole number exactly."""


@dataclass(frozen=True, eq=False)
class Labels:
    """Labels of N pictures of one film.

    Attributes:
        frames: (N,) numbers of the pictures, rising, each once.
        points: (N, P, 2) px, NaN = not labelled.
        names: of the P keypoints.

    Raises InputError for a number that comes twice, is not whole or is negative, and where nothing is labelled.
    """

    frames: np.ndarray
    points: np.ndarray
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        frames = np.asarray(self.frames, dtype=float)
        if strange := [f for f in frames if not (0 <= f < MAX_NUMBER and f == round(f))]:
            raise InputError(f"a picture's number must be a whole one from 0 on, got {strange[0]:g}")
        order = np.argsort(frames, kind="stable")
        object.__setattr__(self, "frames", frames[order].astype(np.int64))
        object.__setattr__(self, "points", np.asarray(self.points, dtype=float)[order])
        if (twice := np.flatnonzero(np.diff(self.frames) == 0)).size:
            raise InputError(f"picture {self.frames[twice[0]]} is labelled twice: drop one of its rows")

    def __len__(self) -> int:
        return len(self.frames)

    @property
    def seen(self) -> np.ndarray:
        """(N, P) whether a keypoint is labelled."""
        return np.isfinite(self.points).all(-1)

    def chosen(self, which: np.ndarray) -> "Labels":
        """Those of a mask or of indices."""
        return Labels(self.frames[which], self.points[which], self.names)

    def only(self, names: Sequence[str]) -> "Labels":
        """Those keypoints, in that order. Raises InputError for one that is not labelled."""
        if missing := [name for name in names if name not in self.names]:
            raise InputError(f"keypoint {missing[0]!r} is not labelled: the labels have {', '.join(self.names)}")
        return Labels(self.frames, self.points[:, [self.names.index(name) for name in names]], tuple(names))

    def check_within(self, width: int, height: int) -> None:
        """Raise InputError for a point outside pictures of this size, px; one on their edge may be half a pixel out."""
        within = (self.points >= -1.0) & (self.points <= [width, height])
        outside = self.seen & ~within.all(-1)
        if outside.any():
            n, p = np.argwhere(outside)[0]
            u, v = self.points[n, p]
            raise InputError(
                f"{self.names[p]} of picture {self.frames[n]} lies outside its pictures of {width} × {height} px, at "
                f"({u:g}, {v:g}): are the labels another film's, or of a scaled copy?"
            )

    def joined(self, newer: "Labels") -> "Labels":
        """These and newer ones of the same keypoints, which win where a picture is in both."""
        kept = ~np.isin(self.frames, newer.frames)
        points = newer.only(self.names).points
        return Labels(
            np.concatenate([self.frames[kept], newer.frames]), np.concatenate([self.points[kept], points]), self.names
        )


def read_labels(path: str | Path, individual: str | None = None) -> Labels:
    """Read a file of labels; `individual` chooses in files of several animals.

    Raises:
        InputError: a file of none of those kinds, or in which nothing is labelled.
        OSError: a file that cannot be opened.
    """
    path = Path(path)
    with about(path):
        rows = read_rows(path) if path.suffix.lower() == ".csv" else []
        if rows and "frame" in rows[0][1]:
            labels = _ours(path)
        elif _collected(rows):
            labels = _read_collected(rows, individual)
        else:
            read = FORMATS[recognise(path)].read
            if read is None:
                raise InputError(
                    "expected labels: a column 'frame' with the pictures' numbers, then <keypoint>_x and _y in px; or "
                    "a file of DeepLabCut or SLEAP"
                )
            labels = _from_recording(read(path, 1.0, individual))  # one a second: times are numbers
        if not labels.seen.any():
            raise InputError("nothing is labelled in this file")
        if (beyond := np.abs(labels.points) > 1e5).any():
            frame = labels.frames[np.argwhere(beyond)[0][0]]
            raise InputError(f"a label of picture {frame} lies beyond any picture: expected px")
        return labels


def write_labels(labels: Labels, path: str | Path) -> None:
    """Write our own table, whole or not at all. Raises OSError when `path` cannot be written."""
    columns = {"frame": labels.frames.astype(float)}
    for p, name in enumerate(labels.names):
        columns |= {f"{name}_x": labels.points[:, p, 0], f"{name}_y": labels.points[:, p, 1]}
    write_table(columns, path)


def _ours(path: Path) -> Labels:
    columns, _ = read_table(path)
    stems = [name[:-2] for name in columns if name != "frame" and name.endswith(("_x", "_y"))]
    names = tuple(dict.fromkeys(stems))
    expected = {"frame", *(f"{name}_{axis}" for name in names for axis in "xy")}
    if strange := sorted(set(columns) ^ expected):
        raise InputError(f"column {strange[0]!r}: expected 'frame', then <keypoint>_x and <keypoint>_y of each")
    if not names:
        raise InputError("no keypoint: expected columns <keypoint>_x and <keypoint>_y in addition to 'frame'")
    points = np.stack([np.stack([columns[f"{name}_{axis}"] for axis in "xy"], -1) for name in names], 1)
    return Labels(columns["frame"], points, names)


def _from_recording(recording: Recording) -> Labels:
    if recording.keypoints.shape[-1] != 2:
        raise InputError("these points lie in space: labels are pixels of one film")
    return Labels(np.round(recording.time), recording.keypoints, recording.keypoint_names)


def _collected(rows: Sequence[Row]) -> bool:
    """Whether these are DeepLabCut's labels, whose rows begin with an image's path."""
    first = next((cells for _, cells in rows if cells[0] not in LEVELS), [""])
    return bool(rows) and rows[0][1][0] == "scorer" and _image(first) is not None


def _image(cells: Sequence[str]) -> int | None:
    """Number of the column, of the first three, that holds an image's name."""
    return next((i for i, cell in enumerate(cells[:3]) if re.search(r"\d+\.(png|jpe?g|bmp|tiff?)$", cell, re.I)), None)


def _read_collected(rows: Sequence[Row], individual: str | None) -> Labels:
    header = {cells[0]: cells for _, cells in rows[:4] if cells[0] in LEVELS}
    if not {"bodyparts", "coords"} <= set(header):
        raise InputError("not DeepLabCut's labels: the header lines start with scorer, bodyparts, coords")
    body = rows[len(header) :]
    before = (_image(body[0][1]) or 0) + 1  # cells that name the image: its path, or folder, film and file
    numbered = []
    for line, cells in body:
        found = re.search(r"(\d+)\.\w+$", cells[before - 1]) if len(cells) >= before else None
        if found is None:
            raise InputError(f"line {line}: expected an image whose name ends in the picture's number, img012.png")
        numbered.append((line, [found[1], *cells[before:]]))
    columns = list(zip(*(header[level][before:] for level in LEVELS[1:] if level in header), strict=True))
    numbers, _ = read_numbers(numbered, ["image", *(" ".join(column) for column in columns)])
    names, tracks = assembled(columns, numbers[:, 1:], individual)
    return Labels(numbers[:, 0], np.stack([tracks["x"], tracks["y"]], -1), names)
