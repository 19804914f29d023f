"""Conversion of declared units to SI: lengths become metres, angles radians and times seconds.

Pixels point down the image: y ↦ −y makes them point up (the image's height is not known, and only shifts the origin);
they stay pixels unless a scale in metres a pixel is given.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from .errors import InputError
from .recording import Recording
from .units import FRAMES, METRES, RADIANS, TIMES, Units


def to_si(
    recording: Recording,
    units: Units,
    scale: float | None = None,
    fps: float | None = None,
    shifting: Collection[str] = (),
) -> Recording:
    """Convert numbers as they stand in a file.

    Args:
        recording: numbers in `units`; its `length_unit` is ignored.
        units: a missing length means m, a missing angle rad, a missing time s.
        scale: metres a pixel; without it pixels stay pixels, with y up.
        fps: frames a second, of times that are numbers of frames.
        shifting: joints that shift, whose positions are in m for all units of angles.

    Raises:
        InputError: a scale that is not positive, or without pixels; pixels in three dimensions.
    """
    if scale is not None and units.length != "px":
        raise InputError("a scale (metres a pixel) needs --units px")
    if units.length == "px":
        if recording.keypoints.shape[-1] != 2:
            raise InputError("these keypoints have three coordinates, so they cannot be px: pass --units mm or m")
        recording = replace(recording, keypoints=recording.keypoints * [1.0, -1.0], length_unit="px")
        if scale is not None:
            recording = recording.scaled(scale, "m")
    else:
        recording = recording.scaled(METRES[units.length or "m"], "m")
    if recording.angles is not None and units.angle == "deg":
        factors = [1.0 if name in shifting else RADIANS["deg"] for name in recording.joint_names]
        recording = replace(recording, angles=recording.angles * factors)
    if units.time == FRAMES:
        recording = replace(recording, time=recording.time / fps)
    elif units.time is not None:
        recording = replace(recording, time=recording.time * TIMES[units.time])
    return recording


def median_link_lengths(recording: Recording, chain: Sequence[str] | None = None) -> np.ndarray:
    """Median distance between successive keypoints of `chain` (by default all), over frames with both.

    Returns (len(chain) − 1,) in the recording's length unit; NaN where the two are never seen together.
    """
    if chain is None:
        return median_distances(recording.keypoints)
    return median_distances(np.stack([recording.keypoint(name) for name in chain], axis=1))


def in_body_lengths(recording: Recording, chain: Sequence[str] | None = None, length: float = 1.0) -> Recording:
    """Scale so that the chain, the sum of its median link lengths, is `length` long: for films with no scale.

    A length of 1 makes it the unit, "body length"; any other is a body's own, in m.

    Raises InputError when that sum is unknown or zero.
    """
    total = float(median_link_lengths(recording, chain).sum())
    if not (np.isfinite(total) and total > 0):
        raise InputError("the body's length is unknown: two neighbours of its chain are never seen together")
    return recording.scaled(length / total, "body length" if np.isclose(length, 1.0) else "m")


def median_distances(chain: np.ndarray) -> np.ndarray:
    """Medians over frames of the distances between neighbours, (T, P, S) → (P − 1,); NaN where no frame has both."""
    distances = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    return np.array([np.median(d[np.isfinite(d)]) if np.isfinite(d).any() else np.nan for d in distances.T])
