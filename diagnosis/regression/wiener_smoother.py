"""Angle, velocity and acceleration of each joint a posteriori: a Kalman smoother on what encoders show.

The third derivative of an angle is white, so the state x = (q, q̇, q̈) is a twice integrated Wiener process (Särkkä &
Solin 2019, ch. 12; its mean is the quintic smoothing spline of Wahba 1978):

    x_t = A x_{t−1} + N(0, s² Q),   y_t = q_t + N(0, r²),    A = exp(F h),   F = [[0,1,0],[0,0,1],[0,0,0]]

    Q_ij = h^{5−i−j} / ((2−i)! (2−j)! (5−i−j)),   i, j = 0, 1, 2

The ratio s/r is the most probable one of a grid, r follows from the innovations of a Kalman filter, through which all
joints and all ratios pass at once. Means and covariances given all rows come from square roots
(:mod:`invdyn.inference.smoothing.square_root`), as the start says next to nothing.

Shapes: T rows, K joints, G ratios. Units: rad, s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.inference.smoothing.square_root import backward, forward_covariance, forward_mean


@dataclass(frozen=True)
class SmoothedAngles:
    """Posterior of one stretch: `mean` (T, K, 3) and `covariance` (T, K, 3, 3) of (q, q̇, q̈); `noise` (K,) is r."""

    time: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray


def smooth(stretches: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[SmoothedAngles]:
    """Smooth stretches, each of times (T,) and angles (T, K), NaN where missing; they share noise and roughness."""
    seen = [np.isfinite(angle).all(1) for _, angle in stretches]
    longest = int(np.argmax([each.sum() for each in seen]))
    begin = int(seen[longest].argmax())  # where all joints are seen
    time, angle = (values[begin : begin + FIXED.max_likelihood_rows] for values in stretches[longest])
    step = float(np.median(np.diff(time)))
    rough = 10.0 ** np.arange(*FIXED.roughness_decades) / step**2.5
    ratio, noise = _most_likely(time, angle, rough[:, None] * np.ones(angle.shape[1]))
    return [smoothed(time, angle, ratio, noise) for time, angle in stretches]


def _most_likely(time: np.ndarray, angle: np.ndarray, ratios: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The ratio s/r and the noise r, each (K,), of the highest likelihood among ``ratios`` (G, K)."""
    innovation, variance = _innovations(time, angle, ratios)
    seen = np.isfinite(innovation)
    count = seen.sum(0) - 3
    square = np.where(seen, innovation**2 / variance, 0.0)[3:].sum(0) / count
    # by differences an encoder that stands still has no noise
    square = np.maximum(square, np.finfo(float).tiny)
    score = -0.5 * count * np.log(square) - 0.5 * np.where(seen, np.log(variance), 0.0)[3:].sum(0)
    best = score.argmax(0)
    joints = np.arange(angle.shape[1])
    return ratios[best, joints], np.sqrt(square[best, joints])


def transitions(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A (T−1, 3, 3) and Q (T−1, 3, 3) for s = 1."""
    h = np.diff(time)
    A, Q = np.zeros((len(h), 3, 3)), np.zeros((len(h), 3, 3))
    for i in range(3):
        for j in range(3):
            if j >= i:
                A[:, i, j] = h ** (j - i) / factorial(j - i)
            Q[:, i, j] = h ** (5 - i - j) / (factorial(2 - i) * factorial(2 - j) * (5 - i - j))
    return A, Q


def start(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (K, 3) and covariance (3, 3), in units of r, of a start that says nothing.

    That is any angle of the range, and rates that cross it in a few rows.
    """
    h = float(np.median(np.diff(time)))
    spread = max(float(np.nanmax(np.abs(angle - np.nanmean(angle, 0)), initial=0.0)), 1e-9)
    mean = np.zeros((angle.shape[1], 3))
    mean[:, 0] = np.where(np.isfinite(angle[0]), angle[0], np.nanmean(angle, 0))
    return mean, np.diag([spread**2, (spread / h) ** 2, (spread / h**2) ** 2]) * 1e2 / _floor(angle) ** 2


def _innovations(time: np.ndarray, angle: np.ndarray, ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Innovations of the filter and their variances, (T, …, K), in units of r; ``ratio`` (…, K)."""
    A, Q = transitions(time)
    first, prior = start(time, angle)
    mean = np.broadcast_to(first, (*ratio.shape, 3))
    covariance = np.broadcast_to(prior, (*ratio.shape, 3, 3))
    square = (ratio**2)[..., None, None]
    innovations, variances = np.empty((2, len(time), *ratio.shape))
    for t in range(len(time)):
        if t:
            a = A[t - 1]
            mean, covariance = mean @ a.T, a @ covariance @ a.T + square * Q[t - 1]
        e, v = angle[t] - mean[..., 0], covariance[..., 0, 0] + 1.0
        gain = covariance[..., 0] / v[..., None] * np.isfinite(e)[..., None]
        mean = mean + gain * np.nan_to_num(e)[..., None]
        covariance = covariance - gain[..., :, None] * covariance[..., None, 0, :]
        innovations[t], variances[t] = e, v
    return innovations, variances


def _floor(angle: np.ndarray) -> float:
    """A small angle, rad: a hundredth of the median step of those that move."""
    steps = np.abs(np.diff(angle, axis=0))
    moved = steps[steps > 0]
    return float(np.median(moved)) / 100 if moved.size else 1e-9


def smoothed(time: np.ndarray, angle: np.ndarray, ratio: np.ndarray, noise: np.ndarray) -> SmoothedAngles:
    """A stretch given all of its rows, by a ``ratio`` and a ``noise`` of each joint, (K,)."""
    A, Q = transitions(time)
    first, prior = start(time, angle)
    joints, rows = angle.shape[::-1]
    roots = np.concatenate([prior[None] ** 0.5, np.linalg.cholesky(Q)]) * np.ones((joints, 1, 1, 1))
    roots[:, 1:] *= ratio[:, None, None, None]
    seen = np.isfinite(angle.T)
    shown = seen[..., None, None] * np.eye(3)[:1]
    onward = np.broadcast_to(A, (joints, *A.shape))
    still = np.zeros((joints, rows - 1, 3))
    factors = backward(onward, still, roots, shown, np.where(seen, angle.T, 0.0)[..., None], first)
    mean, covariance = (each.swapaxes(0, 1) for each in (forward_mean(factors, first), forward_covariance(factors)))
    return SmoothedAngles(time, mean, covariance * noise[:, None, None] ** 2, noise)
