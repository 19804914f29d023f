"""Labels that several pages and programs change at once: each point has a version, and no save erases another's.

Optimistic concurrency control (Kung & Robinson 1981, ACM TODS 6(2)): nothing is locked while a person works. A change
names the version of the point that its author saw. It is accepted if that is still the version, and refused if the
point was changed elsewhere since. All other points are merged. The file is the shared state: it is read again before
each write, so that what another program wrote counts as a change of its points.

Shapes: N pictures, P keypoints; points in px.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..atomic import exclusive
from ..errors import InputError, about
from .labels import Labels, read_labels, write_labels


@dataclass(frozen=True)
class Change:
    """One point of one picture, by their places in the lists of pictures and keypoints.

    Attributes:
        picture, keypoint: places from 0.
        point: (u, v) px, or None where the keypoint is not labelled.
        version: of the point as its author saw it.
    """

    picture: int
    keypoint: int
    point: tuple[float, float] | None
    version: int


class SharedLabels:
    """Labels of N pictures in the file ``path``, which others may change meanwhile.

    Args:
        path: .csv; made with the first label, absent while there is none.
        numbers: (N,) numbers of the pictures in the film.
        names: of the P keypoints.

    Attributes:
        points: (N, P, 2) px, NaN = not labelled.
        versions: (N, P) number of the revision that changed each point last, 0 for none.
        revision: number of revisions so far.

    Raises InputError for a file that holds no labels, or those of other keypoints.
    """

    def __init__(self, path: Path, numbers: Sequence[int], names: Sequence[str]):
        self.path, self.numbers, self.names = path, list(numbers), tuple(names)
        self.points = np.full((len(self.numbers), len(self.names), 2), np.nan)
        self.versions = np.zeros((len(self.numbers), len(self.names)), int)
        self.revision = 0
        self._others: Labels | None = None  # of pictures outside `numbers`
        self._lock = threading.Lock()
        self._read()

    @property
    def labels(self) -> Labels:
        """All labels, also those of other pictures in the file."""
        labelled = np.isfinite(self.points).all(-1).any(-1)
        own = Labels(np.array(self.numbers, int)[labelled], self.points[labelled], self.names)
        return own if self._others is None else self._others.joined(own)

    def save(self, changes: Sequence[Change]) -> list[Change]:
        """Merge ``changes`` with what others wrote and write the file; the refused ones' points, as they are now.

        Raises InputError for a file that others made unreadable, OSError where it cannot be written; then nothing is
        changed here or there.
        """
        with self._lock, exclusive(self.path):
            before = self.points.copy(), self.versions.copy(), self.revision, self._others
            try:
                self._read()
                read = self.revision
                refused = [change for change in changes if not self._accepted(change)]
                if self.revision > read:
                    self._write()
            except BaseException:
                self.points, self.versions, self.revision, self._others = before
                raise
            return [self._now(change.picture, change.keypoint) for change in refused]

    def changed_since(self, revision: int) -> list[Change]:
        """Points that were changed after a ``revision``, as they are now."""
        with self._lock:
            return [self._now(i, p) for i, p in np.argwhere(self.versions > revision).tolist()]

    def _now(self, picture: int, keypoint: int) -> Change:
        place = picture, keypoint
        return Change(picture, keypoint, _pair(self.points[place]), int(self.versions[place]))

    def _accepted(self, change: Change) -> bool:
        """Whether a change was made to the point as it is; one that changes nothing always is."""
        place = change.picture, change.keypoint
        if change.point == _pair(self.points[place]):
            return True
        if change.version != self.versions[place]:
            return False
        self._set(place, change.point)
        return True

    def _set(self, place: tuple[int, int], point: tuple[float, float] | None) -> None:
        self.revision += 1
        self.points[place], self.versions[place] = np.nan if point is None else point, self.revision

    def _read(self) -> None:
        """Take over the file's content; a file that was deleted changes nothing, and is written again."""
        if not self.path.exists():
            return
        labels = read_labels(self.path)
        if set(labels.names) != set(self.names):
            with about(self.path):
                raise InputError(
                    f"labels of {', '.join(labels.names)} are there: continue with these, or name another file"
                )
        labels = labels.only(self.names)
        row_of = {int(frame): row for frame, row in zip(labels.frames, labels.points, strict=True)}
        unlabelled = np.full((len(self.names), 2), np.nan)
        for i, number in enumerate(self.numbers):
            for p, point in enumerate(row_of.get(number, unlabelled)):
                if _pair(point) != _pair(self.points[i, p]):
                    self._set((i, p), _pair(point))
        self._others = labels.chosen(np.flatnonzero(~np.isin(labels.frames, self.numbers)))

    def _write(self) -> None:
        labels = self.labels
        if labels.seen.any():
            write_labels(labels, self.path)
        else:  # a table without a label is not allowed
            self.path.unlink(missing_ok=True)


def _pair(point: np.ndarray) -> tuple[float, float] | None:
    """A point (2,) as two numbers; None where it is not labelled."""
    return (float(point[0]), float(point[1])) if np.isfinite(point).all() else None
