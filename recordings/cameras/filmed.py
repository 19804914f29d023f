"""A recording that several cameras made: their pixels, which a model observes, and the points triangulated from them.

The points are for figures, and where a fit begins; what is inferred comes from the pixels, so that a keypoint which one
camera sees counts, and no triangulation's error is taken for noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np

from ..errors import InputError
from ..recording import Recording
from .formats import read_calibration
from .scene import reconstruct
from .views import Views, at_one_time, match_names, put_in_order, read_tracks


@dataclass(frozen=True, eq=False)
class Filmed(Recording):
    """See the top of the file.

    Attributes:
        views: of the same times and keypoints; their calibration is metric, in the frame of the keypoints (T, P, 3) m.

    Raises:
        InputError: views of other times or keypoints, or none.
    """

    views: Views | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.views is None or self.views.keypoint_names != self.keypoint_names:
            raise InputError("expected views of the recording's own keypoints")
        if not np.array_equal(self.views.time, self.time):
            raise InputError("expected views at the recording's own times")

    def at(self, frames: slice | np.ndarray) -> Self:
        """Some frames, a slice or a mask (T,); times stay. Raises InputError if under 2 remain."""
        assert self.views is not None  # as it was made
        plain = self.points.at(frames)
        own = {each.name: getattr(plain, each.name) for each in fields(Recording)}
        return type(self)(**own, views=self.views.at(frames))

    @property
    def points(self) -> Recording:
        """The triangulated points alone, as of a recording that is in metres from the first."""
        return Recording(**{each.name: getattr(self, each.name) for each in fields(Recording)})

    def relative_to(self, keypoint: str) -> Recording:
        """Raise InputError: cameras stand where they stand."""
        raise InputError(f"{self.name}: pixels are not taken relative to {keypoint!r}: leave --set base out")


def filmed(views: Views, name: str = "recording") -> Filmed:
    """The recording of ``views``.

    Raises:
        InputError: a calibration that is not metric, or as `triangulate`.
    """
    if not views.calibration.metric:
        raise InputError(
            "the calibration does not say what its lengths are in: `invdyn triangulate … --length FROM:TO=METRES "
            "--calibration-out metric.toml` writes one that does"
        )
    found = reconstruct(views, name=name).recording
    own = {each.name: getattr(found, each.name) for each in fields(Recording)}
    return Filmed(**own, views=views)


def load_filmed(
    files: Sequence[str],
    calibration: Sequence[Path],
    keypoints: Sequence[str],
    *,
    offsets: Mapping[str, float] | None = None,
    fps: float | None = None,
    format: str | None = None,
    individual: str | None = None,
) -> Filmed:
    """Read one file of tracks a camera. Exchanged sides of a person are put in order, with a warning (:mod:`..sides`).

    Args:
        files: as `match_names`.
        calibration: files, as `read_calibration`.
        keypoints: those of a body; of the tracks' others nothing is kept.
        offsets: by how much cameras' clocks run ahead, s, as `at_one_time`.
        fps, format, individual: as `recordings.load`.

    Raises:
        InputError: what is wrong with the files, no keypoint of the body among them, or one never seen.
        OSError: a file that cannot be opened.
    """
    cameras = read_calibration(list(calibration), None)
    named = match_names(list(files), cameras.names)
    views = at_one_time(read_tracks(named, cameras, fps=fps, format=format, individual=individual), cameras, offsets)
    views = put_in_order(views)
    known = [name for name in keypoints if name in views.keypoint_names]
    if not known:
        raise InputError(
            f"no keypoint of the body is in the tracks: it has {', '.join(keypoints)}, they have "
            f"{', '.join(views.keypoint_names)}: rename them"
        )
    views = views.select(known)
    for name, seen in zip(known, np.isfinite(views.pixels).all(-1).any((0, 1)), strict=True):
        if not seen:
            raise InputError(f"keypoint {name!r} is missing in every frame of every camera")
    return filmed(views, name=next(iter(named.values())).stem)
