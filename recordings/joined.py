"""Several recordings of one body as one: end to end, or a robot's log and a camera's keypoints on the log's clock."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .errors import InputError
from .recording import Recording


def joined(recordings: Sequence[Recording]) -> tuple[Recording, tuple[int, ...]]:
    """One recording after the other, each a frame interval behind the one before, and the rows at which one starts.

    Times start at the first recording's own. The first row of all is not among the rows (R − 1,).

    Raises InputError for none, and where they are not of the same keypoints, coordinates, joints and unit, or not all
    have angles, torques or confidences.
    """
    if not recordings:
        raise InputError("expected one recording or more, got none")
    first = recordings[0]
    if len(recordings) == 1:
        return first, ()
    for other in recordings[1:]:
        if odd := next(_differences(first, other), None):
            raise InputError(f"recordings to be diagnosed together must agree: {odd}")
    times, end = [], first.time[0] - first.frame_interval
    for each in recordings:
        times.append(each.time - each.time[0] + end + each.frame_interval)
        end = times[-1][-1]
    starts = np.cumsum([each.num_frames for each in recordings])[:-1]
    columns: dict[str, Any] = {
        field: None if getattr(first, field) is None else np.concatenate([getattr(r, field) for r in recordings])
        for field in ("keypoints", "confidence", "angles", "torques")
    }
    name = " + ".join(each.name for each in recordings)
    return replace(first, time=np.concatenate(times), name=name, **columns), tuple(int(s) for s in starts)


def _differences(first: Recording, other: Recording) -> Iterator[str]:
    for field in ("keypoint_names", "joint_names", "length_unit"):
        mine, yours = getattr(first, field), getattr(other, field)
        if mine != yours:
            yield f"{first.name} has {field} {mine}, {other.name} has {yours}"
    mine, yours = first.keypoints.shape[-1], other.keypoints.shape[-1]
    if mine != yours:
        yield f"keypoints of {first.name} have {mine} coordinates, those of {other.name} {yours}"
    for field in ("confidence", "angles", "torques"):
        if (getattr(first, field) is None) != (getattr(other, field) is None):
            yield f"of {first.name} and {other.name}, only one has {field}"


SAME_TIME = 1e-6
"""s between rows that are one."""


def merge_log_and_camera(log: Recording, film: Recording, ahead: float = 0.0) -> Recording:
    """The log's angles and torques (T, K) with the film's keypoints, in all rows of either while the log runs.

    ``ahead`` is by how much the film's clock runs ahead of the log's, s. What a row lacks is NaN; a command lasts.
    Raises InputError for a log that has keypoints or no angles, a film without keypoints, and where they have no time
    together.
    """
    if log.angles is None or log.keypoint_names:
        raise InputError(f"{log.name}: expected a log of angles, without keypoints of its own, to merge with a film")
    if not film.keypoint_names:
        raise InputError(f"{film.name}: expected keypoints to merge with a log, it has none")
    own = film.time - ahead
    within = (own >= log.time[0] - SAME_TIME) & (own <= log.time[-1] + SAME_TIME)
    if within.sum() < 2:
        raise InputError(
            f"{film.name}: runs from {own[0]:.4g} to {own[-1]:.4g} s on the log's clock, the log from "
            f"{log.time[0]:.4g} to {log.time[-1]:.4g} s: they share no time"
        )
    film, own = film.at(within), own[within]
    # a picture that comes with a row of the log is that row's
    near = np.searchsorted(log.time, own - SAME_TIME).clip(0, len(log.time) - 1)
    own = np.where(np.abs(log.time[near] - own) <= SAME_TIME, log.time[near], own)
    time = np.union1d(log.time, own)
    logged, filmed = np.searchsorted(time, log.time), np.searchsorted(time, own)
    angles = np.full((len(time), log.angles.shape[1]), np.nan)
    angles[logged] = log.angles
    keypoints = np.full((len(time), *film.keypoints.shape[1:]), np.nan)
    keypoints[filmed] = film.keypoints
    confidence = None
    if film.confidence is not None:
        confidence = np.full((len(time), film.confidence.shape[1]), np.nan)
        confidence[filmed] = film.confidence
    current = np.searchsorted(log.time, time, side="right") - 1
    return replace(
        log,
        time=time,
        keypoints=keypoints,
        keypoint_names=film.keypoint_names,
        confidence=confidence,
        angles=angles,
        torques=None if log.torques is None else log.torques[current],
        length_unit=film.length_unit,
    )
