"""Jumps against a motion whose noise and mistakes are known."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from invdyn.diagnosis.problem.outliers import calm

NOISE, ROWS = 1e-3, 200


def motion(rng: np.random.Generator, rate: float = 3.0, every: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) s and a point (T, 2) m that goes round on half a metre, with noise."""
    time = every * np.arange(ROWS)
    arm = 0.5 * np.stack([np.sin(rate * time), np.cos(0.7 * rate * time)], -1)
    return time, arm + NOISE * rng.normal(size=arm.shape)


def calmed(time: np.ndarray, seen: np.ndarray) -> np.ndarray:
    return calm(torch.as_tensor(time), torch.as_tensor(seen)).numpy()


@pytest.mark.parametrize("rate", [0.5, 3.0, 6.0, 9.0])
def test_jumps_are_no_fast_arm(rate):
    """Strays of some thirty standard deviations go, however fast the arm; it and frames that were not seen stay."""
    rng = np.random.default_rng(0)
    time, arm = motion(rng, rate)
    seen = arm.copy()
    strays = [20, 21, 60, 62, 90, 120, 197]
    seen[strays] += 0.03 * rng.choice([-1, 1], size=(len(strays), 2))
    seen[[70, 140]] = np.nan
    left = calmed(time, seen)
    assert np.isnan(left[strays]).all()
    kept, right = np.isfinite(left), np.isfinite(seen)
    right[strays] = False
    assert kept[right].mean() > 0.97
    np.testing.assert_array_equal(left[kept], seen[kept])


@pytest.mark.quick("0", "-1", "-3")
@pytest.mark.parametrize("row", [0, 1, 2, -3, -2, -1])
def test_jumps_at_the_ends(row):
    """Where a parabola goes on beyond its points noise is some five times as large: of strays of 60 all go."""
    for seed in range(20):
        time, arm = motion(np.random.default_rng(seed))
        seen = arm.copy()
        seen[row] += [0.06, -0.06]
        assert np.isnan(calmed(time, seen)[row]).all()
        others = np.delete(np.arange(ROWS), row)
        left = calmed(time, seen)
        assert np.isfinite(left[others]).mean() > 0.98
        assert np.isfinite(left[[each for each in (0, -1) if each != row]]).all()  # not led away by it
        assert np.isfinite(calmed(time[:6], seen[:6])).all()  # too few rows to know what is usual


def test_each_of_several_recordings_has_ends_of_its_own():
    """One begins elsewhere than another ends: that is no jump, and a stray there still is one."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        (time, first), (_, second) = motion(rng), motion(rng)
        both = np.concatenate([first[:100], second[:100]])
        clean = calm(torch.as_tensor(time), torch.as_tensor(both), [100]).numpy()
        assert np.isfinite(clean[97:103]).all()
        assert np.isnan(calmed(time, both)[97:103]).any()
        both[100] += [0.06, -0.06]
        left = calm(torch.as_tensor(time), torch.as_tensor(both), [100]).numpy()
        assert np.isnan(left[100]).all()
        assert np.isfinite(left[97:100]).all()


def test_exchanged_labels_jump():
    time, arm = motion(np.random.default_rng(0))
    seen = arm.copy()
    seen[[20, 90, 91, 150]] = arm[[20, 90, 91, 150], ::-1]
    jumped = np.abs(seen - arm) > 0.05
    assert jumped.sum() >= 4
    assert np.isnan(calmed(time, seen)[jumped]).all()


@given(st.integers(0, 2**32 - 1))
def test_noise_does_not_jump(seed):
    time, arm = motion(np.random.default_rng(seed))
    assert np.isfinite(calmed(time, arm)).mean() > 0.99


def test_frames_that_were_lost_are_no_jump():
    """Parabolas go by times, not by rows."""
    rng = np.random.default_rng(1)
    time, arm = motion(rng, every=0.01)
    kept = rng.random(ROWS) < 0.7
    assert np.isfinite(calmed(time[kept], arm[kept])).mean() > 0.97


def test_what_rests_in_rounded_numbers_and_then_moves():
    time, arm = motion(np.random.default_rng(2))
    arm[:180] = arm[180]
    assert np.isfinite(calmed(time, arm)).all()


def test_nothing_is_asked_of_a_point_that_was_not_seen():
    time, arm = motion(np.random.default_rng(3))
    arm[:, 1] = np.nan
    left = calmed(time, arm)
    assert np.isnan(left[:, 1]).all()
    assert np.isfinite(left[:, 0]).mean() > 0.97
