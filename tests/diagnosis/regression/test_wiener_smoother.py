"""The smoother of angles against the exact Gaussian of all rows, and against the truth of simulated encoders."""

import numpy as np
import pytest

from invdyn.diagnosis.regression.wiener_smoother import smooth, smoothed, start, transitions


def test_it_is_the_gaussian_of_all_rows():
    """Mean and covariance of a chain of 9 rows, one of them unseen, from its precision matrix as a whole."""
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.05, 0.2, 9))
    angle = rng.standard_normal((9, 1))
    angle[4] = np.nan
    ratio, noise = np.array([30.0]), np.array([0.2])
    found = smoothed(time, angle, ratio, noise)
    A, Q = transitions(time)
    ahead, spread = start(time, angle)
    precision, linear = np.zeros((27, 27)), np.zeros(27)
    first = np.linalg.inv(spread * noise**2)
    precision[:3, :3] += first
    linear[:3] += first @ ahead[0]
    for t in range(8):
        own = np.linalg.inv(Q[t] * (ratio * noise) ** 2)
        here, there = slice(3 * t, 3 * t + 3), slice(3 * t + 3, 3 * t + 6)
        precision[here, here] += A[t].T @ own @ A[t]
        precision[there, there] += own
        precision[here, there] -= A[t].T @ own
        precision[there, here] -= own @ A[t]
    for t in np.flatnonzero(np.isfinite(angle[:, 0])):
        precision[3 * t, 3 * t] += 1 / noise[0] ** 2
        linear[3 * t] += angle[t, 0] / noise[0] ** 2
    covariance = np.linalg.inv(precision)
    assert found.mean[:, 0].ravel() == pytest.approx(covariance @ linear, rel=1e-5, abs=1e-5)
    blocks = np.array([covariance[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] for t in range(9)])
    assert found.covariance[:, 0] == pytest.approx(blocks, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("noise", [1e-2, 1e-4])
def test_it_finds_noise_and_motion(noise):
    """Two joints at 250 rows/s: the noise within 10 %, angle and velocity as near as it says."""
    time = np.arange(0, 4, 0.004)
    q = np.stack([np.sin(2 * time) + 0.3 * np.sin(7 * time), 0.5 * np.cos(5 * time)], -1)
    qd = np.stack([2 * np.cos(2 * time) + 2.1 * np.cos(7 * time), -2.5 * np.sin(5 * time)], -1)
    seen = q + noise * np.random.default_rng(1).standard_normal(q.shape)
    (found,) = smooth([(time, seen)])
    assert found.noise == pytest.approx(noise, rel=0.1)
    sd = np.sqrt(np.einsum("tkii->tki", found.covariance))
    for n, truth in enumerate((q, qd)):
        scaled = (found.mean[..., n] - truth) / sd[..., n]
        assert 0.4 < np.sqrt((scaled**2).mean()) < 1.2
    assert np.sqrt(((found.mean[..., 0] - q) ** 2).mean()) < 0.5 * noise
