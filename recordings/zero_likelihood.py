"""Coordinates that a tracker writes for a missing point; they become NaN.

- A likelihood of 0 means that nothing was found (OpenPose and COCO write 0, 0, 0).
- In pixels (0, 0) is the image's corner, which a sub-pixel estimate does not hit exactly.
- Other trackers write a place whose coordinates are all one whole number: 0 0 0, −1 −1 or 999 999. The place may also
  be a position like others: it is missing if no step between two rows of the track is as long as its distance from the
  track's nearest point.
- The last good position may be written again, to the last digit. With noise of σ in a track of resolution q a
  position repeats with a probability of (0.28 q/σ)^S in S axes. Where σ is `PLAUSIBLE.finer` times q, and the track has
  no shorter repeats, as one behind a median filter has, repeats are no positions.

A position that is repeated while the likelihood is low, in a track that tells nothing of its noise, may be a hidden arm
at rest. A warning says so; the data stay as they are.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .errors import InputError
from .jitter import point_jitter
from .limits import PLAUSIBLE
from .recording import Recording


def without_zeros(recording: Recording, pixels: bool, in_file: bool = True) -> Recording:
    """The recording with missing points as NaN; only one that was just read from a file is warned of for what stays.

    A likelihood that is 0 for all points in all frames was not written by a tracker, and is dropped.

    Raises InputError when nothing is left of a keypoint that had positions.
    """
    points, confidence = recording.keypoints.copy(), recording.confidence
    if confidence is not None and not np.nan_to_num(confidence).any():
        confidence = None
    if confidence is not None:
        points[confidence == 0] = np.nan
    _drop_sentinels(recording.keypoint_names, points, pixels)
    _drop_repeats(recording.keypoint_names, points)
    had, has = (np.isfinite(each).any(axis=(0, 2)) for each in (recording.keypoints, points))
    for name, before, after in zip(recording.keypoint_names, had, has, strict=True):
        if before and not after:
            raise InputError(f"keypoint {name!r} is missing in every frame: its likelihood is 0")
    if confidence is not None and in_file:
        for name, track, likelihood in zip(
            recording.keypoint_names, np.moveaxis(points, 1, 0), confidence.T, strict=True
        ):
            _warn_of_repeats(name, track, likelihood)
    return replace(recording, keypoints=points, confidence=confidence)


def _drop_sentinels(names: Sequence[str], points: np.ndarray, pixels: bool) -> None:
    """Set places that are no positions to NaN in ``points`` (T, P, S), with a warning for each keypoint."""
    for name, track in zip(names, np.moveaxis(points, 1, 0), strict=True):
        same = (track == np.round(track)).all(axis=-1) & (track == track[:, :1]).all(axis=-1)
        for value in np.unique(track[same, 0]):
            there = same & (track[:, 0] == value)
            # In pixels most rows at (0, 0) mean an origin, to which the tracks are relative.
            corner = pixels and value == 0
            farther = 1.0 if value == 0 else PLAUSIBLE.farther
            if there.mean() < 0.5 if corner else _unreached(track, there, farther):
                track[there] = np.nan
                place = ", ".join([f"{value:.12g}"] * points.shape[-1])
                where = f"the image's corner ({place})" if corner else f"{'' if value else 'the origin '}({place})"
                warnings.warn(
                    f"{name} is at {where} in {there.sum()} of {len(track)} rows: taken to be missing", stacklevel=3
                )


def _drop_repeats(names: Sequence[str], points: np.ndarray) -> None:
    """Set rows that repeat the one before to NaN in ``points`` (T, P, S), where its noise allows no repeats."""
    for name, track in zip(names, np.moveaxis(points, 1, 0), strict=True):
        runs = [(start + 1, stop) for start, stop in _repeats(track)]
        again = int((track[1:] == track[:-1]).all(axis=-1).sum())
        repeated = sum(stop - start for start, stop in runs)
        fresh = track.copy()
        for run in runs:
            fresh[slice(*run)] = np.nan
        seen = fresh[np.isfinite(fresh).all(axis=-1)]
        if not runs or again > repeated or len(seen) < PLAUSIBLE.positions:
            continue
        steps = np.abs(np.diff(seen, axis=0))
        (noise,) = point_jitter(fresh[:, None])
        if not (steps > 0).any() or noise < PLAUSIBLE.least_noise * np.ptp(seen):
            continue
        resolution = min(np.quantile(axis[axis > 0], 0.01) for axis in steps.T if (axis > 0).any())
        if noise > PLAUSIBLE.finer * resolution:
            track[:] = fresh
            warnings.warn(
                f"{name} stands still to the last digit in {repeated} rows, first from row {runs[0][0] + 1} to "
                f"{runs[0][1]}: the last position was written again; taken to be missing",
                stacklevel=3,
            )


def _unreached(track: np.ndarray, there: np.ndarray, farther: float) -> bool:
    """Whether a place lies farther from all other positions of a track (T, S) than steps between them are long.

    By a factor of ``farther`` or more; ``there`` are the rows (T,) at that place.
    """
    others = track[np.isfinite(track).all(axis=-1) & ~there]
    place = track[there][0]
    distance, step = (np.linalg.norm(each, axis=-1) for each in (others - place, np.diff(others, axis=0)))
    return len(others) >= PLAUSIBLE.positions and bool(distance.min() > farther * step.max(initial=0.0))


def _repeats(track: np.ndarray) -> list[tuple[int, int]]:
    """First row and that after the last one of runs of a position (T, S) to the last digit; NaN differs from itself."""
    same = (track[1:] == track[:-1]).all(axis=-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(start, stop + 1) for start, stop in runs if stop + 1 - start >= PLAUSIBLE.repeats]


def _warn_of_repeats(name: str, track: np.ndarray, confidence: np.ndarray) -> None:
    runs = _repeats(track)
    if not runs or np.isnan(confidence).all():
        return
    low = PLAUSIBLE.low_likelihood * np.nanmedian(confidence)
    # A likelihood that is missing is not a low one.
    known = [(start, stop) for start, stop in runs if not np.isnan(confidence[start:stop]).all()]
    doubted = [(start, stop) for start, stop in known if np.nanmax(confidence[start:stop]) < low]
    if doubted:
        start, stop = max(doubted, key=lambda run: run[1] - run[0])
        rows = sum(stop - start for start, stop in doubted)
        warnings.warn(
            f"{name} stands still to the last digit in {rows} rows, such as {start + 1} to {stop}, and its likelihood "
            "is under half of its median there: if it was not seen, leave these cells empty",
            stacklevel=3,
        )
