"""Noise of detections at rest, beside noise that grows with speed."""

import numpy as np
import pytest
import torch

from invdyn.diagnosis.problem.noise_floor import noise_at_rest as noise_of_points
from invdyn.diagnosis.problem.noise_floor import shrunk, variance_of_log
from invdyn.diagnosis.problem.outliers import calm
from invdyn.recordings.jitter import jitter

SIGMA, ROWS = 0.001, 800
TIME = np.arange(ROWS) / 100


def noise_at_rest(time, points):
    """Of points in the plane as columns (T, 2P)."""
    return noise_of_points(time, points.reshape(len(points), -1, 2))


def track(rng, mistimed=0.0, blur=0.0):
    """A point that swings on a circle, rests now and then, and is seen with noise, (T, 2) m; its speed (T,) m/s."""
    angle = 1.5 * np.sin(2 * np.pi * 0.5 * TIME) * np.sin(2 * np.pi * 0.06 * TIME)
    true = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)
    velocity = np.gradient(true, TIME, axis=0)
    speed = np.linalg.norm(velocity, axis=-1)
    noise = SIGMA * (1 + blur * speed)[:, None] * rng.standard_normal((ROWS, 2))
    return true + noise + mistimed * rng.standard_normal((ROWS, 1)) * velocity, speed


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_does_not_grow_is_what_differences_say(seed):
    points = track(np.random.default_rng(seed))[0]
    np.testing.assert_array_equal(noise_at_rest(TIME, points), [jitter(points).mean()])


def test_what_differences_say_is_known_as_well_as_stated():
    """And noise that is the same of all points is found to be so, or nearly."""
    said = np.array([jitter(np.random.default_rng(seed).standard_normal((300, 6))) for seed in range(200)])
    each = said.reshape(-1, 3, 2).mean(-1)
    variance = variance_of_log(np.full(3, 600))
    # 400 degrees of freedom: relative sd of a variance √(2/400).
    assert np.log(each).var(axis=1, ddof=1).mean() == pytest.approx(variance[0], rel=4 * np.sqrt(2 / 400))
    nearer = np.array([shrunk(one, variance) for one in each])
    assert np.log(nearer).var(axis=1).mean() < 0.4 * np.log(each).var(axis=1).mean()
    np.testing.assert_allclose(np.log(nearer).mean(1), np.log(each).mean(1))


def test_noises_that_differ_stay_apart():
    one = np.array([1.0, 1.5, 0.0])
    variance = variance_of_log(np.array([600, 600, 0]))
    nearer = shrunk(one, variance)
    assert nearer[2] == 0.0  # nobody saw it
    assert np.log(nearer[1] / nearer[0]) == pytest.approx(np.log(1.5) * (1 - 4 * variance[0] / np.log(1.5) ** 2))
    np.testing.assert_array_equal(shrunk(one[:1], variance[:1]), one[:1])
    np.testing.assert_array_equal(shrunk(np.ones(2), variance[:2]), np.ones(2))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("grows", [{"mistimed": 0.005}, {"blur": 4.0}])
def test_noise_that_grows_is_found_where_it_rests(seed, grows):
    points, _ = track(np.random.default_rng(seed), **grows)
    assert jitter(points).mean() > 1.8 * SIGMA
    # 200 values in the slowest bins: a median's sd of 8 %, and as much for the growth beside it.
    assert noise_at_rest(TIME, points) == pytest.approx([SIGMA], rel=0.35)


def test_what_grows_is_at_rest_what_the_others_are():
    """It is known to a third, and they to a twentieth: a third more or less is no difference."""
    rng = np.random.default_rng(0)
    points = np.concatenate([track(rng)[0], track(rng, blur=4.0)[0]], 1)
    still, blurred = noise_at_rest(TIME, points)
    assert still == pytest.approx(jitter(points[:, :2]).mean(), rel=0.02)
    assert blurred == pytest.approx(still)
    assert blurred < 0.8 * jitter(points[:, 2:]).mean()


def test_stray_detections_and_gaps_are_passed_over():
    rng = np.random.default_rng(1)
    points, _ = track(rng, blur=4.0)
    points[rng.random(ROWS) < 0.03] += 0.2
    points[rng.random(ROWS) < 0.1, 0] = np.nan
    assert noise_at_rest(TIME, points) == pytest.approx([SIGMA], rel=0.4)


def test_stray_detections_are_no_growth_with_speed():
    """Where a detection strays its neighbours look fast: without it the noise at rest is nearer the truth."""
    off = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points = track(rng)[0][:216]
        points[rng.random(216) < 0.08] += 0.1 * rng.standard_normal(2)
        calmed = calm(torch.as_tensor(TIME[:216]), torch.as_tensor(points)).numpy()
        off.append([np.log(noise_at_rest(TIME[:216], each)[0] / SIGMA) for each in (points, calmed)])
    stray, calmed = np.abs(off).mean(0)
    assert calmed < 0.7 * stray
    assert calmed < 0.35


def test_of_too_few_frames_the_average_is_taken():
    points, _ = track(np.random.default_rng(2), blur=4.0)
    np.testing.assert_array_equal(noise_at_rest(TIME[:80], points[:80]), [jitter(points[:80]).mean()])


def test_a_fast_camera_that_saw_a_moment():
    points = track(np.random.default_rng(5))[0][:90]
    assert noise_at_rest(TIME[:90] / 20, points) == pytest.approx([SIGMA], rel=0.3)


def test_a_point_that_never_moves_or_is_not_noisy():
    assert noise_at_rest(TIME, np.ones((ROWS, 2))) == [0.0]
    still = np.random.default_rng(3).standard_normal((ROWS, 2))
    assert noise_at_rest(TIME, still) == pytest.approx([1.0], rel=0.1)
