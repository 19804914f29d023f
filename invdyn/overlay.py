"""What was inferred, laid over the film that it was inferred from.

A recording's metres come from the film's pixels by one scale s and an origin c of each picture, which is always the
same but where keypoints are taken relative to a base:

    pixel(t) = c(t) + s (x, −y)

Both are found again by least squares between tracks and observed positions, so that nothing but these two files need be
known.
"""

from collections.abc import Iterator

import arviz as az
import numpy as np

from invdyn.recordings import InputError, Recording, read_keypoint_csv
from invdyn.recordings.reading import TrackedFilm
from invdyn.recordings.tracking.film import Film, read_pictures

MAX_SIDE = 720  # px of the longer side of what is drawn


class Overlay:
    """Pictures behind an arm in the plane, and its place in them.

    Args:
        film: the film.
        tracks: its keypoints, px, v down, one row a picture.
        idata: what was inferred, (T,) rows of it.

    Raises InputError where positions and tracks have nothing in common.
    """

    def __init__(self, film: Film, tracks: Recording, idata: az.InferenceData):
        self.film = film
        self.size = film.height, film.width
        time = idata["posterior"]["time"].values
        self._numbers = np.abs(time[:, None] - tracks.time).argmin(1)
        seen = idata["observed_data"]["position"].transpose("time", "keypoint", "space")
        tips = [str(name) for name in seen["keypoint"].values]
        pixels = np.stack([tracks.keypoint(tip)[self._numbers] for tip in tips], 1)
        x = seen.values * [1.0, -1.0]
        known = np.isfinite(pixels).all(-1) & np.isfinite(x).all(-1)
        if known.sum() < 2:
            raise InputError(f"{film.path}: its tracks and what was inferred share no two points")
        each = known[..., None].astype(float)
        count = each.sum(1)
        several = (count > 1).any()
        middle, centre = (np.where(each > 0, v, 0.0).sum(1) / np.maximum(count, 1.0) for v in (x, pixels))
        if not several:  # one point a picture: its scale is that of the track
            middle, centre = (np.broadcast_to(v[known].mean(0), (len(time), 2)) for v in (x, pixels))
        off, seen_off = ((v - m[:, None])[known] for v, m in ((x, middle), (pixels, centre)))
        self.scale = float((off * seen_off).sum() / (off**2).sum())
        self._origin = _filled(np.where(count > 0, centre - self.scale * middle, np.nan))

    @classmethod
    def of(cls, tracked: TrackedFilm, idata: az.InferenceData) -> "Overlay":
        """Over the film that was tracked."""
        return cls(Film(tracked.path), read_keypoint_csv(tracked.tracks), idata)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Points (…, T, P, 2) m, y up, in px, v down."""
        return self._origin[:, None] + self.scale * points * [1.0, -1.0]

    def pictures(self, rows: np.ndarray, box: tuple[int, int, int, int]) -> Iterator[np.ndarray]:
        """RGB (h, w, 3) of what lies in a box (left, top, right, bottom), px, in rows, rising; large ones scaled down.

        Raises InputError when the film is shorter.
        """
        left, top, right, bottom = box
        factor = min(1.0, MAX_SIDE / max(right - left, bottom - top))
        size = round(factor * self.size[0]), round(factor * self.size[1])
        down, across = (
            slice(*np.round(factor * np.array(ends)).astype(int)) for ends in ((top, bottom), (left, right))
        )
        numbers = self._numbers[rows]
        own, again = np.unique(numbers, return_counts=True)  # rows that bridge a gap may share a picture
        for picture, count in zip(read_pictures(self.film, own.tolist(), size), again, strict=True):
            for _ in range(count):
                yield picture[down, across]


def _filled(track: np.ndarray) -> np.ndarray:
    """A track (T, 2) without gaps: linear between what is known."""
    known = np.isfinite(track).all(-1)
    rows = np.arange(len(track))
    return np.stack([np.interp(rows, rows[known], column[known]) for column in track.T], -1)
