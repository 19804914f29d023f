"""The protocol of trackers, from pictures in order to keypoints with confidence; and tracking a film with one.

A film is tracked in parts of `PART` pictures. Each finished part can be saved, with the tracker's memory, so that a
run that was killed continues with the same result.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from ..errors import InputError
from ..tables import write_table
from .film import Film

PART = 64
"""Pictures after which a run is saved."""

Progress = Callable[[int, int, str], None]


class Tracker(Protocol):
    """Finds keypoints in pictures that come one after the other.

    Attributes:
        memory: a vector of any length, the state from one picture to the next; setting it continues from there.
    """

    memory: np.ndarray

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """Of the P keypoints."""

    @property
    def picture_size(self) -> tuple[int, int] | None:
        """(height, width) in which it wants the pictures, or None for as they are."""

    def track(self, picture: np.ndarray) -> np.ndarray:
        """From RGB (H, W, 3) uint8 to (P, 3): u, v in px of that picture, and confidence from 0 to 1.

        NaN where nothing is found. Raises InputError where the picture is ambiguous.
        """


class Keeper(Protocol):
    """Storage of a long run; `inference.execution.checkpoint.Checkpoint` is one."""

    def save(self, tensors: Mapping[str, Tensor], *, step: int = 0, **state: Any) -> None:
        """Replace what is stored."""

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """The last saved state, with its `step`; None before the first."""


def track_film(
    film: Film, tracker: Tracker, progress: Progress | None = None, keeper: Keeper | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Track all pictures: times (T,) s and (T, P, 3), u, v in px of the film's own pictures, and confidence.

    Raises InputError when no keypoint is found in any picture, and as film and tracker do.
    """
    size = tracker.picture_size
    factor = np.ones(2) if size is None else np.array([film.width / size[1], film.height / size[0]])
    times: list[float] = []
    rows: list[np.ndarray] = []
    if keeper is not None and (kept := keeper.load()) is not None:
        tensors, _ = kept
        times, rows = tensors["time"].tolist(), list(tensors["rows"].numpy())
        tracker.memory = tensors["memory"].numpy()
    for picture in film.pictures(size, start=len(rows)):
        found = np.array(tracker.track(picture.rgb), dtype=float)
        found[:, :2] = (found[:, :2] + 0.5) * factor - 0.5
        times.append(picture.time)
        rows.append(found)
        if progress is not None:
            progress(len(rows), max(film.expected, len(rows)), "track")
        if keeper is not None and len(rows) % PART == 0:
            tensors = {"time": torch.tensor(times, dtype=torch.float64), "rows": torch.tensor(np.array(rows))}
            keeper.save(tensors | {"memory": torch.as_tensor(tracker.memory, dtype=torch.float64)}, step=len(rows))
    tracks = np.array(rows)
    if not np.isfinite(tracks[..., :2]).any():
        raise InputError(f"{film.path}: nothing to track was found in any of its {len(rows)} pictures")
    return np.array(times), tracks


def write_tracks(names: tuple[str, ...], times: np.ndarray, tracks: np.ndarray, path: str | Path) -> None:
    """Write times (T,) s and tracks (T, P, 3) as a keypoint CSV in px, v down; `--units px` reads it.

    Raises OSError when `path` cannot be written.
    """
    columns = {"time": times}
    for p, name in enumerate(names):
        columns |= {f"{name}_{part}": tracks[:, p, i] for i, part in enumerate(("x", "y", "likelihood"))}
    write_table(columns, path)
