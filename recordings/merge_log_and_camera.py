"""A robot's log and a camera's keypoints as one recording, with the rows of both, on the log's clock."""

from dataclasses import replace

import numpy as np

from .errors import InputError
from .recording import Recording

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
