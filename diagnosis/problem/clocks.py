"""By how much a camera's clock runs ahead of a robot log's, from the motion that both have seen.

The log's angles say where the sites are, X(θ(t)), in the body's frame. A camera sees them o seconds later on its own
clock, in a frame and to a scale that need not be the body's:

    y_p(t) = s R X_p(θ(t − o)) + c + error,      s, R, c in closed form for each o (Umeyama 1991)

The offset is where what this leaves, as a share of the keypoints' variance, is least: over a grid of all offsets at
which half of the shorter one is shared, then by Brent's method. Frames that lie far off count for no more than three
medians. Its standard error comes from stretches of the film with independent errors, by the sandwich estimator that
sets cameras' clocks (:mod:`invdyn.recordings.cameras.synchronise`), with stretches as its clusters.

Shapes: F frames, S sites of d coordinates.
"""

from collections.abc import Callable

import numpy as np
import torch
from scipy.optimize import minimize_scalar

from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras.synchronise import Clock, sandwich_sd


def camera_clock(log: Recording, film: Recording, body: ArticulatedBody, rules: Rules = DEFAULT) -> Clock:
    """By how much ``film``'s times run ahead of those of a ``log`` of the same motion, of ``body``'s angles.

    Raises InputError where they share too little time, nothing moves enough to tell, or several offsets fit equally
    well.
    """
    places = _places(log, film, body, rules)
    own, step = film.time, 2 * max(film.frame_interval, log.frame_interval)
    shared = rules.check.min_clock_overlap * min(film.duration, log.duration)
    grid = np.arange(own[0] + shared - log.time[-1], own[-1] - shared - log.time[0] + step, step)
    few = slice(None, None, -(-film.num_frames // rules.check.max_grid_frames))

    def left(offset: float, frames: slice = slice(None)) -> float:
        terms, variance = _misfits(places(own[frames] - offset), film.keypoints[frames], rules)
        return float(np.nanmean(terms)) / variance if variance > 0 else np.inf

    values = np.array([left(offset, few) for offset in grid])
    if not np.isfinite(values).any() or values.min() > rules.check.min_clock_overlap:
        raise InputError(
            f"{film.name}: nothing in it moves as the log says, with any clock: check its keypoints, or state "
            "--set clock=SECONDS"
        )
    best = int(values.argmin())
    elsewhere = np.delete(values, np.arange(*_valley(values, best)))
    if elsewhere.size and elsewhere.min() < rules.check.min_contrast * values[best]:
        raise InputError(
            f"{film.name}: several offsets of its clock fit as well, as the motion repeats: state --set clock=SECONDS"
        )
    around = grid[best] - step, grid[best] + step
    found = minimize_scalar(left, bounds=around, method="bounded", options={"xatol": 1e-3 * step})
    return Clock(float(found.x), _sd(places, film, float(found.x), step / 2, rules))


def _places(log: Recording, film: Recording, body: ArticulatedBody, rules: Rules) -> Callable[[np.ndarray], np.ndarray]:
    """From times (F,) to the film's keypoints (F, S, d) as the log has them, NaN where it has nothing near."""
    if log.angles is None:
        raise InputError(f"{log.name}: expected a log with angles, to set a camera's clock by")
    known = np.isfinite(log.angles).all(1)
    if known.sum() < rules.check.min_clock_points:
        raise InputError(
            f"{log.name}: expected {rules.check.min_clock_points} rows with all angles for a camera's clock, "
            f"got {known.sum()}: record longer"
        )
    time, angles = log.time[known], torch.as_tensor(log.angles[known])
    order = [body.keypoint_names.index(name) for name in film.keypoint_names]
    numbers = body.completed(body.parameters())
    from scipy.interpolate import CubicSpline  # half a second to import, which most runs do not need

    course = CubicSpline(time, dynamics_for(body).keypoints(angles, numbers).numpy()[:, order])
    apart = rules.check.max_log_gap * float(np.median(np.diff(time)))

    def at(when: np.ndarray) -> np.ndarray:
        after = np.searchsorted(time, when).clip(1, len(time) - 1)
        near = (when >= time[0]) & (when <= time[-1]) & (time[after] - time[after - 1] <= apart)
        return np.where(near[:, None, None], course(when), np.nan)

    return at


def _misfits(X: np.ndarray, y: np.ndarray, rules: Rules) -> tuple[np.ndarray, float]:
    """Squares (F, S) by which y (F, S, d) misses the best similarity of X, NaN where one is missing; y's variance.

    That is 0 where fewer than `min_clock_points` points are in both.
    """
    seen = np.isfinite(X).all(-1) & np.isfinite(y).all(-1)
    misfits = np.full(seen.shape, np.nan)
    X, y = X[seen], y[seen]
    if len(y) < rules.check.min_clock_points:
        return misfits, 0.0
    weight = np.ones(len(y))
    for _ in range(2):
        share = weight / weight.sum()
        x0, y0 = X - share @ X, y - share @ y
        u, s, vt = np.linalg.svd((share[:, None] * y0).T @ x0)
        turn = np.ones(len(s))
        turn[-1] = np.sign(np.linalg.det(u @ vt))
        scale = (s * turn).sum() / max(float(share @ (x0**2).sum(-1)), 1e-300)
        off = ((y0 - scale * x0 @ (u * turn @ vt).T) ** 2).sum(-1)
        most = rules.check.max_point_misfit**2 * max(float(np.median(off)), 1e-300)
        weight = np.minimum(1.0, most / np.maximum(off, 1e-300))
    misfits[seen] = np.minimum(off, most)
    return misfits, float(share @ (y0**2).sum(-1))


def _valley(values: np.ndarray, best: int) -> tuple[int, int]:
    """First and one past the last place about ``best`` until which values only rise."""
    first = last = best
    while first > 0 and values[first - 1] >= values[first]:
        first -= 1
    while last < len(values) - 1 and values[last + 1] >= values[last]:
        last += 1
    return first, last + 1


def _sd(places: Callable[[np.ndarray], np.ndarray], film: Recording, offset: float, step: float, rules: Rules) -> float:
    """Standard deviation of the offset, s; infinite where nothing tells."""

    def misfits(by: float) -> np.ndarray:
        """(B,) of each stretch."""
        terms, _ = _misfits(places(film.time - by), film.keypoints, rules)
        return np.array([np.nansum(part) for part in np.array_split(terms, rules.check.num_clock_blocks)])

    return sandwich_sd(misfits, offset, step)
