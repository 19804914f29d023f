"""Noise from differences of what was seen."""

import math

import numpy as np
import pytest

from invdyn.recordings.jitter import ORDERS, jitter, point_jitter


def test_noise_is_estimated_next_to_a_fast_motion():
    """A swing at 4 Hz, 60 frames/s: its third differences are above those of the noise, its fifth ones far below."""
    rng = np.random.default_rng(0)
    swing = 0.05 * np.sin(2 * np.pi * 4.0 * np.arange(600) / 60)
    noise = 0.0005 * rng.standard_normal((600, 2))
    found = jitter(np.stack([noise[:, 0], swing + noise[:, 1]], -1))
    assert found == pytest.approx([0.0005, 0.0005], rel=0.15)


def test_noise_is_estimated_next_to_a_motion_that_differences_of_fifth_order_still_show():
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


@pytest.mark.parametrize("dimensions", [2, 3])
def test_noise_of_a_point_does_not_depend_on_the_axes(dimensions):
    """Also where one direction has ten times the noise; columns by themselves would see it in others as well."""
    rng = np.random.default_rng(3)
    matrix = np.linalg.qr(rng.standard_normal((dimensions, dimensions)))[0]
    noise = 0.01 * rng.standard_normal((400, 2, dimensions))
    noise[:, 1, 0] *= 10
    found, rotated = point_jitter(noise), point_jitter(noise @ matrix.T)
    np.testing.assert_allclose(rotated, found, rtol=1e-9)
    assert found == pytest.approx([0.01, 0.1], rel=0.15)
    columns = [jitter(each.reshape(400, -1)).reshape(2, dimensions).max(1) for each in (noise, noise @ matrix.T)]
    assert not np.allclose(*columns, rtol=0.02)


def test_an_axis_that_is_hardly_seen_does_not_hide_the_others():
    rng = np.random.default_rng(4)
    points = 0.01 * rng.standard_normal((300, 2, 2))
    points[:, 0, 1] = np.nan
    points[::9, 1, 1] = np.nan
    points[:250, 1, 0] = np.nan
    assert point_jitter(points) == pytest.approx([0.01, 0.01], rel=0.3)
    assert point_jitter(np.full((9, 1, 2), np.nan)) == [0.0]
