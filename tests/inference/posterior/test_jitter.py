"""Noise from differences of what was seen."""

import math

import numpy as np
import pytest

from invdyn.inference.posterior.jitter import ORDERS, jitter


def test_noise_is_estimated_beside_a_fast_motion():
    """A swing at 4 Hz, 60 frames/s: its third differences are above those of the noise, its fifth ones far below."""
    rng = np.random.default_rng(0)
    swing = 0.05 * np.sin(2 * np.pi * 4.0 * np.arange(600) / 60)
    noise = 0.0005 * rng.standard_normal((600, 2))
    found = jitter(np.stack([noise[:, 0], swing + noise[:, 1]], -1))
    assert found == pytest.approx([0.0005, 0.0005], rel=0.15)


def test_noise_is_estimated_beside_a_motion_that_differences_of_fifth_order_still_show():
    """At 9 Hz they have five times the noise, the tenth a ninth; and of noise alone higher orders tell no less."""
    rng = np.random.default_rng(2)
    swing = 0.5 * np.sin(2 * np.pi * 9.0 * np.arange(400) / 60 + 1.0)
    noise = 0.004 * rng.standard_normal((400, 200))
    fifth = np.diff(swing, n=5) / math.sqrt(math.comb(10, 5))
    assert np.median(np.abs(fifth)) > 4 * 0.6745 * 0.004
    assert jitter(swing[:, None] + noise).mean() == pytest.approx(0.004, rel=0.1)
    alone = jitter(noise)
    usual = [
        min(np.median(np.abs(np.diff(column, n=n))) / math.comb(2 * n, n) ** 0.5 for n in ORDERS) for column in noise.T
    ]
    assert np.mean(np.isclose(alone, 1.4826 * np.array(usual))) > 0.97


def test_noise_of_gaps_and_of_too_few():
    rng = np.random.default_rng(1)
    column = 0.1 * rng.standard_normal(1000)
    column[::5] = np.nan
    few = np.full(1000, np.nan)
    few[:3] = 1.0
    found = jitter(np.stack([column, few], -1))
    assert found[0] == pytest.approx(0.1, rel=0.1)
    assert found[1] == 0.0
