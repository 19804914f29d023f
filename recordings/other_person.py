"""Keypoints jump together: from there on a tracker follows another person, or the other arm of the same one.

Let d_p(t) be the step of keypoint p from the row before, and m_p(t) the median of its steps in the 2 W + 1 rows around.
A body that moves has d ≈ m, and a keypoint that is wrong for itself leaves the others where they are, so that

    e(t) = lower median over p of |d_p(t) − m_p(t)|

is small, but where they jump together. Rows between two such jumps are one piece. The longest one shows the person that
is meant; another does, too, from the row on, of the W + 1 next to the jump, that is within `JUMP` of the place at which
the pieces that are kept end. After g rows that are not kept it may be min(1 + g, `FARTHER`) times as far off, if that
is nearer than the ends of those. What is left is another person's, and is missing.

Shapes: T rows, P keypoints, S axes.
"""

import warnings
from dataclasses import replace
from itertools import pairwise

import numpy as np

from .recording import Recording

WINDOW = 5  # W
JUMP = 0.4
"""Of the distance of the outermost keypoints: a smaller jump of them is no exchange."""
FARTHER = 3.0
"""Times as far as `JUMP` that a person may have moved while others were tracked."""
UNUSUAL = 10.0
"""Times the 90 % quantile of e(t), that a jump exceeds."""
LONGEST_STEP = 2.5
"""Frame intervals: across a longer step a body may have gone anywhere."""
MIN_POINTS, MIN_ROWS = 2, 10  # keypoints of a row that counts; such rows


def without_others(recording: Recording) -> Recording:
    """The recording with rows of another person as NaN; a UserWarning says which. Encoders stay."""
    points, time = recording.keypoints, recording.time
    if recording.length_unit == "px" and points.shape[-1] != 2:
        return recording
    jumps = jump_rows(points, time)
    if not len(jumps):
        return recording
    kept = _kept(points, jumps, _size(points))
    rows = ~kept & np.isfinite(points).any((1, 2))
    if not rows.any():
        return recording
    first, last = np.flatnonzero(rows)[[0, -1]]
    own = np.flatnonzero(kept & np.isfinite(points).any((1, 2)))[[0, -1]]
    inside = f"; --frames {own[0]}:{own[1] + 1} leaves them out" if first < own[0] or last > own[1] else ""
    warnings.warn(
        f"{recording.name}: keypoints jump together, as if another person or the other arm were tracked, in "
        f"{rows.sum()} rows from row {first + 1} ({time[first]:.6g} s) to row {last + 1}: taken to be missing{inside}",
        stacklevel=4,
    )
    confidence = recording.confidence
    return replace(
        recording,
        keypoints=np.where(rows[:, None, None], np.nan, points),
        confidence=None if confidence is None else np.where(rows[:, None], np.nan, confidence),
    )


def jump_rows(points: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Rows at which keypoints (T, P, S) have jumped together since the row before that has any."""
    seen = np.flatnonzero(np.isfinite(points).all(-1).sum(1) >= MIN_POINTS)
    if len(seen) < MIN_ROWS:
        return seen[:0]
    steps = np.diff(points[seen], axis=0)
    around = np.stack([np.roll(steps, shift, 0) for shift in range(-WINDOW, WINDOW + 1)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of keypoints that are never seen
        excess = np.linalg.norm(steps - np.nanmedian(around, axis=0), axis=-1)
    least = _lower_median(excess)
    both = np.isfinite(excess).sum(-1) >= MIN_POINTS
    if not both.any():
        return seen[:0]
    interval = np.diff(time[seen])
    near = both & (interval <= LONGEST_STEP * np.median(np.diff(time)))
    limit = max(JUMP * _size(points), UNUSUAL * float(np.quantile(least[both], 0.9)))
    return seen[1:][near & (np.nan_to_num(least) > limit)]


def _lower_median(values: np.ndarray) -> np.ndarray:
    """Of the numbers in each row (T, P), (T,); NaN of none."""
    middle = np.maximum(np.isfinite(values).sum(-1) - 1, 0) // 2  # NaN is sorted behind all numbers
    return np.take_along_axis(np.sort(values, axis=-1), middle[:, None], -1)[:, 0]


def _size(points: np.ndarray) -> float:
    """Median over rows of the distance between the outermost keypoints."""
    ends = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1).reshape(len(points), -1)
    ends = np.nan_to_num(ends).max(-1)
    return float(np.median(ends[ends > 0])) if (ends > 0).any() else np.inf


def _kept(points: np.ndarray, jumps: np.ndarray, size: float) -> np.ndarray:
    """Rows (T,) of the longest piece and of those that continue it, to either side."""
    edges = [0, *jumps.tolist(), len(points)]
    pieces = list(pairwise(edges))
    main = max(range(len(pieces)), key=lambda k: np.isfinite(points[slice(*pieces[k])]).any((1, 2)).sum())
    kept = np.zeros(len(points), bool)
    kept[slice(*pieces[main])] = True
    for way, others in ((1, pieces[main + 1 :]), (-1, pieces[:main][::-1])):
        here = _seen_rows(points, pieces[main])[::-way][:1]
        others_end = here[:0]
        for piece in others:
            own = _seen_rows(points, piece)[::way]
            near = own[: WINDOW + 1]
            gone = np.abs(near - here)
            off = _off(points, near, here)
            close = off < JUMP * size * np.minimum(gone, FARTHER)
            for end in (*others_end, *own[:1]):
                close &= (gone <= 1) | (near == end) | (off < _off(points, near, end))
            if close.any():
                kept[own[int(close.argmax()) :]] = True
                here, others_end = own[-1:], here[:0]
            elif len(own):
                others_end = own[-1:]
    return kept


def _off(points: np.ndarray, rows: np.ndarray, row: np.ndarray) -> np.ndarray:
    """How far (R,) the keypoints are in ``rows`` from where they are in one; infinite where none is in both."""
    return np.nan_to_num(_lower_median(np.linalg.norm(points[rows] - points[row], axis=-1)), nan=np.inf)


def _seen_rows(points: np.ndarray, piece: tuple[int, int]) -> np.ndarray:
    """Rows of a piece that show some keypoints (T, P, S)."""
    return piece[0] + np.flatnonzero(np.isfinite(points[slice(*piece)]).all(-1).sum(1) >= MIN_POINTS)
