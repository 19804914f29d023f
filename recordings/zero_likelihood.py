"""Coordinates that a tracker writes for a missing point; they become NaN.

- A likelihood of 0 means that nothing was found (OpenPose and COCO write 0, 0, 0).
- In pixels (0, 0) is the image's corner, which a sub-pixel estimate does not hit exactly.
- Motion capture writes 0 0 0 in metres or mm. The origin may also be a position like others: it is missing if no step
  between two rows of the track is as long as the distance from the origin to the track's nearest point.

A position that is repeated to the last digit while the likelihood is low may be the last good one, written again. A
warning says so; the data stay as they are, since a hidden arm may be at rest.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .errors import InputError
from .limits import PLAUSIBLE
from .recording import Recording


def without_zeros(recording: Recording, pixels: bool) -> Recording:
    """The recording with missing points as NaN.

    A likelihood that is 0 for all points in all frames was not written by a tracker, and is dropped.

    Raises InputError when nothing is left of a keypoint that had positions.
    """
    points, confidence = recording.keypoints.copy(), recording.confidence
    if confidence is not None and not np.nan_to_num(confidence).any():
        confidence = None
    if confidence is not None:
        points[confidence == 0] = np.nan
    _drop_zeros(recording.keypoint_names, points, pixels)
    had, has = (np.isfinite(each).any(axis=(0, 2)) for each in (recording.keypoints, points))
    for name, before, after in zip(recording.keypoint_names, had, has, strict=True):
        if before and not after:
            raise InputError(f"keypoint {name!r} is missing in every frame: its likelihood is 0")
    if confidence is not None:
        for name, track, likelihood in zip(
            recording.keypoint_names, np.moveaxis(points, 1, 0), confidence.T, strict=True
        ):
            _warn_of_repeats(name, track, likelihood)
    return replace(recording, keypoints=points, confidence=confidence)


def _drop_zeros(names: Sequence[str], points: np.ndarray, pixels: bool) -> None:
    """Set exact zeros that are no positions to NaN in ``points`` (T, P, S), with a warning for each keypoint."""
    where = "the image's corner (0, 0)" if pixels else f"the origin ({', '.join('0' * points.shape[-1])})"
    for name, track in zip(names, np.moveaxis(points, 1, 0), strict=True):
        zero = (track == 0).all(axis=-1)
        # In pixels most rows there mean an origin, to which the tracks are relative.
        if not zero.any() or not (zero.mean() < 0.5 if pixels else _unreached(track, zero)):
            continue
        track[zero] = np.nan
        warnings.warn(f"{name} is at {where} in {zero.sum()} of {len(track)} rows: taken to be missing", stacklevel=3)


def _unreached(track: np.ndarray, zero: np.ndarray) -> bool:
    """Whether the origin lies farther from all other positions of a track (T, S) than the longest step between them."""
    others = track[np.isfinite(track).all(axis=-1) & ~zero]
    distance, step = (np.linalg.norm(each, axis=-1) for each in (others, np.diff(others, axis=0)))
    return len(others) >= PLAUSIBLE.positions and bool(distance.min() > step.max(initial=0.0))


def _warn_of_repeats(name: str, track: np.ndarray, confidence: np.ndarray) -> None:
    same = (track[1:] == track[:-1]).all(axis=-1)  # NaN differs from itself
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    runs = [
        (start, stop + 1)
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop + 1 - start >= PLAUSIBLE.repeats
    ]
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
