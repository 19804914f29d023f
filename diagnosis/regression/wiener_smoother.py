"""Angle, velocity and acceleration of each joint a posteriori: a Kalman smoother on what encoders show.

The third derivative of an angle is white, so the state x = (q, q̇, q̈) is a twice integrated Wiener process (Särkkä &
Solin 2019, ch. 12; its mean is the quintic smoothing spline of Wahba 1978):

    x_t = A x_{t−1} + N(0, s² Q),   y_t = q_t + N(0, r²),    A = exp(F h),   F = [[0,1,0],[0,0,1],[0,0,0]]

    Q_ij = h^{5−i−j} / ((2−i)! (2−j)! (5−i−j)),   i, j = 0, 1, 2

The ratio s/r is the most probable one of a grid, r follows from the innovations. Then come the backward means and
covariances of Rauch, Tung & Striebel (1965). All joints, and all ratios, pass in one recursion.

Shapes: T rows, K joints, G ratios. Units: rad, s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import factorial

import numpy as np

from invdyn.diagnosis.rules import FIXED


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
    return [backward_pass(time, angle, ratio, noise) for time, angle in stretches]


def _most_likely(time: np.ndarray, angle: np.ndarray, ratios: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The ratio s/r and the noise r, each (K,), of the highest likelihood among ``ratios`` (G, K)."""
    *_, innovation, variance = forward_pass(time, angle, ratios, keep=False)
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


def forward_pass(time: np.ndarray, angle: np.ndarray, ratio: np.ndarray, keep: bool = True) -> tuple[np.ndarray, ...]:
    """Means and covariances of the filter and of its predictions, in units of r; innovations and their variances.

    ``ratio`` (…, K). Lists of (T, …, K, 3) and (T, …, K, 3, 3); the first two are of length 0 unless kept.
    """
    A, Q = transitions(time)
    h = float(np.median(np.diff(time)))
    spread = max(float(np.nanmax(np.abs(angle - np.nanmean(angle, 0)), initial=0.0)), 1e-9)
    shape = ratio.shape
    first = np.where(np.isfinite(angle[0]), angle[0], np.nanmean(angle, 0))
    mean = np.zeros((*shape, 3))
    mean[..., 0] = first
    # a start that says nothing: any angle of the range, and rates that cross it in a few rows
    prior = np.diag([spread**2, (spread / h) ** 2, (spread / h**2) ** 2]) * 1e2 / _floor(angle) ** 2
    covariance = np.broadcast_to(prior, (*shape, 3, 3)).copy()
    square = (ratio**2)[..., None, None]
    kept: list[list[np.ndarray]] = [[], [], [], []]
    innovations, variances = np.empty((len(time), *shape)), np.empty((len(time), *shape))
    for t in range(len(time)):
        if t:
            a = A[t - 1]
            mean, covariance = mean @ a.T, a @ covariance @ a.T + square * Q[t - 1]
        if keep:
            kept[2].append(mean)
            kept[3].append(covariance)
        e, v = angle[t] - mean[..., 0], covariance[..., 0, 0] + 1.0
        gain = covariance[..., 0] / v[..., None] * np.isfinite(e)[..., None]
        mean = mean + gain * np.nan_to_num(e)[..., None]
        covariance = covariance - gain[..., :, None] * covariance[..., None, 0, :]
        if keep:
            kept[0].append(mean)
            kept[1].append(covariance)
        innovations[t], variances[t] = e, v
    return (*(np.array(each) for each in kept), innovations, variances)


def _floor(angle: np.ndarray) -> float:
    """A small angle, rad: a hundredth of the median step of those that move."""
    steps = np.abs(np.diff(angle, axis=0))
    moved = steps[steps > 0]
    return float(np.median(moved)) / 100 if moved.size else 1e-9


def backward_pass(time: np.ndarray, angle: np.ndarray, ratio: np.ndarray, noise: np.ndarray) -> SmoothedAngles:
    """The backward pass of a stretch."""
    A, _ = transitions(time)
    mean, covariance, ahead, ahead_covariance, *_ = forward_pass(time, angle, ratio)
    for t in range(len(time) - 2, -1, -1):
        # G = P Aᵀ (P⁻)⁻¹, of symmetric matrices, scaled to a unit diagonal against rounding
        root = np.sqrt(np.einsum("kii->ki", ahead_covariance[t + 1]))
        even = ahead_covariance[t + 1] / (root[:, :, None] * root[:, None, :])
        cross = (A[t] @ covariance[t]) / root[:, :, None]
        gain = np.swapaxes(np.linalg.solve(even, cross) / root[:, :, None], 1, 2)
        mean[t] += np.einsum("kij,kj->ki", gain, mean[t + 1] - ahead[t + 1])
        change = covariance[t + 1] - ahead_covariance[t + 1]
        covariance[t] += gain @ change @ np.swapaxes(gain, 1, 2)
    return SmoothedAngles(time, mean, covariance * noise[:, None, None] ** 2, noise)
