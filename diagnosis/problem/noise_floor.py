"""The noise of detections that do not move, which jitter, blur and mistimed frames let grow with speed.

Differences of a track show its noise (:func:`.jitter.differences`). Sorted by the speed v of the point, their
medians in `num_speed_bins` bins are compared with a noise that is the same everywhere and with two that grow:

    σ,    σ (1 + k v)  of speeds in the plane,    √(σ² + k² v²)  of speeds along the coordinate

The noise at rest is σ of the first, unless one of the others fits better beyond chance.

One camera and one network saw all points. Of each point alone the noise is known to a twentieth at best, and to a third
where it grows. That is too little to tell points apart by, and a point said to have too little noise looks as if its
noise grew. Of their differences so much is believed as is worth more than their number (Akaike's criterion as a
shrinkage factor):

    log σ_p → m + w (log σ_p − m),    m = Σ (log σ_p / s_p²) / Σ 1/s_p²

    w = max(0, 1 − 2 (P − 1) / Σ (log σ_p − m)²/s_p²)

Shapes: T rows, P points.
"""

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from invdyn.diagnosis.rules import FIXED
from invdyn.recordings.jitter import MEDIAN, differences, jitter

Growth = Callable[[np.ndarray, float], np.ndarray]
"""Speeds (N,) and k → noise, in units of that at rest."""


def noise_at_rest(time: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Noise sd, m, of each of P points (T, P, d) at ``time`` (T,) s when it does not move; 0 without enough rows."""
    average = jitter(points.reshape(len(points), -1)).reshape(points.shape[1:]).mean(1)
    tracks = points.swapaxes(0, 1)
    rest = np.array([_at_rest(time, track, usual) for usual, track in zip(average, tracks, strict=True)])
    grows = rest < average
    variance = np.where(grows, FIXED.growth_log_sd**2, variance_of_log(np.isfinite(tracks).sum((1, 2))))
    nearer = shrunk(rest, variance)
    return np.where(grows, np.minimum(average, nearer), nearer)


def variance_of_log(count: np.ndarray) -> np.ndarray:
    """Variance of the logarithm of a noise's sd from the differences of so many values."""
    return FIXED.difference_overlap * MEDIAN / np.maximum(count, 1)


def shrunk(sd: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Noise sds (P,) of sensors of one kind, known with these variances of their logarithms, nearer to one another."""
    known = sd > 0
    others = int(known.sum()) - 1
    if others < 1:
        return sd
    log, weight = np.log(sd[known]), 1 / variance[known]
    mean = np.average(log, weights=weight)
    apart = float((weight * (log - mean) ** 2).sum())
    believed = max(0.0, 1 - 2 * others / apart) if apart > 0 else 0.0
    nearer = sd.copy()
    nearer[known] = np.exp(mean + believed * (log - mean))
    return nearer


def _at_rest(time: np.ndarray, track: np.ndarray, usual: float) -> float:
    """Of one point's ``track`` (T, d), whose noise is ``usual`` on average; no more than that."""
    from scipy.signal import savgol_filter  # a third of a second to import, which a fit does not need

    seen = np.isfinite(track).all(-1)
    time, track = time[seen], track[seen]
    if len(track) < FIXED.num_speed_bins * FIXED.min_bin_rows or usual == 0.0:
        return usual
    step = float(np.median(np.diff(time)))
    window = min(max(9, 2 * round(FIXED.velocity_span / step / 2) + 1), 2 * ((len(track) - 1) // 2) + 1)
    velocity = savgol_filter(track, window, FIXED.velocity_degree, deriv=1, delta=step, axis=0)
    speed = np.linalg.norm(velocity, axis=-1)
    sizes, along, whole = [], [], []
    for c in range(track.shape[-1]):
        sizes.append(np.abs(differences(track[:, [c]])[:, 0]))
        # The middle of the rows that a difference is of.
        middle = slice((len(track) - len(sizes[c])) // 2, (len(track) - len(sizes[c])) // 2 + len(sizes[c]))
        along.append(np.abs(velocity[middle, c]))
        whole.append(speed[middle])
    size = np.concatenate(sizes)
    candidates = [
        _fitted(np.concatenate(whole), size, lambda v, k: 1 + k * v),
        _fitted(np.concatenate(along), size, lambda v, k: np.hypot(1.0, k * v)),
    ]
    gain, found = max(candidates)
    return min(usual, found) if gain > FIXED.min_growth_gain else usual


def _fitted(speed: np.ndarray, size: np.ndarray, growth: Growth) -> tuple[float, float]:
    """How much better a noise fits that grows with ``speed`` as ``growth`` (v, k), in variances; and its σ at rest."""
    bins = np.array_split(np.argsort(speed, kind="stable"), FIXED.num_speed_bins)
    v = np.array([speed[each].mean() for each in bins])
    medians = np.array([np.median(size[each]) for each in bins])
    if not (medians > 0).all() or not v.any():
        return 0.0, 0.0
    sd = np.sqrt(variance_of_log(np.array([len(each) for each in bins])))
    seen, v = np.log(1.4826 * medians), v / v.max()

    def misfit(x: np.ndarray) -> np.ndarray:
        return (seen - x[0] - np.log(growth(v, x[1]))) / sd

    constant = np.average(seen, weights=sd**-2)
    fit = least_squares(misfit, [seen[0], 1.0], bounds=([-np.inf, 0.0], [np.inf, np.inf]))
    return float((misfit(np.array([constant, 0.0])) ** 2).sum() - 2 * fit.cost), float(np.exp(fit.x[0]))
