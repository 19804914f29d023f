"""Inverse kinematics as a start: right up to whole turns, through gaps, and for fast limbs."""

import numpy as np
import pytest
import torch

from invdyn.models import ArmModel, Encoders, Keypoints, Link, Observation, kinematics, planar_body
from invdyn.models.kinematics import AGILITY, smooth_angles


def body(joints=2):
    return planar_body(
        "arm", [Link(f"l{k}", f"j{k}", f"t{k}", length=0.3, mass=1.0) for k in range(joints)], base=(0.2, 0.1)
    )


def observed(angles, emission, noise=0.0, seed=0):
    """Rows (T, O) of joint angles (T, K)."""
    time = np.arange(len(angles))
    model = ArmModel(body(angles.shape[1]), time, emission)
    q = torch.as_tensor(angles)
    states = torch.cat([torch.zeros_like(q), q, torch.zeros_like(q)], -1)
    mean = model.emission(states, torch.arange(len(q))).base_dist.loc
    rng = np.random.default_rng(seed)
    return mean + torch.as_tensor(noise * rng.normal(size=mean.shape)), model.body_parameters()


def joint_angle_candidates(time, rows, observation, parameters, sd):
    arm = body(len(sd))
    return kinematics.joint_angle_candidates(arm, time, rows, observation.bound(arm), parameters, sd)


def link_angles(rows, observation, parameters):
    return kinematics.link_angles(rows, observation.bound(body(parameters.length.shape[-1])), parameters)


def best(candidates, angles):
    """Largest error (rad) of the best candidate, but for whole turns of each joint."""
    off = candidates - angles
    turns = np.round(np.median(off, axis=1, keepdims=True) / (2 * np.pi)) * 2 * np.pi
    return np.abs(off - turns).max(axis=(1, 2)).min()


def swing(steps, dt, rates):
    time = dt * np.arange(steps)
    return time, np.stack([0.3 + rate * time + 0.4 * np.sin(3 * time) for rate in rates], -1)


def test_slow_motion_is_recovered():
    time, angles = swing(200, 0.02, (0.5, -0.3))
    rows, parameters = observed(angles, Observation(Keypoints([0, 1])))
    found = joint_angle_candidates(time, rows, Observation(Keypoints([0, 1])), parameters, np.full(2, 1e-3))
    assert found.shape == (len(AGILITY), 200, 2)
    assert best(found, angles) < 0.01


@pytest.mark.parametrize("turns_per_frame", [0.3, 0.45, 0.8, -0.7])
def test_fast_rotation_is_unwrapped(turns_per_frame):
    """Up to most of a turn from frame to frame, where plain unwrapping slips, once it has sped up."""
    steps, dt = 150, 1 / 30
    time = dt * np.arange(steps)
    speed = 2 * np.pi * turns_per_frame / dt * np.clip(np.arange(steps) / 100, 0, 1)
    angles = (np.cumsum(speed) * dt)[:, None]
    rows, parameters = observed(angles, Observation(Keypoints([0])), noise=1e-3)
    found = joint_angle_candidates(time, rows, Observation(Keypoints([0])), parameters, np.full(1, 5e-3))
    assert best(found, angles) < 0.1
    if abs(turns_per_frame) > 0.5:
        measured = link_angles(rows, Observation(Keypoints([0])), parameters)[0]
        assert np.abs(np.unwrap(measured[:, 0]) - angles[:, 0]).max() > np.pi


def test_exchanged_labels_at_the_start_throw_no_link_into_whirling():
    """Swapped tips turn both links round; a whole turn more in every frame would look the same to a camera."""
    time, angles = swing(200, 1 / 60, (1.0, -2.0))
    rows, parameters = observed(angles, Observation(Keypoints([0, 1])), noise=2e-3)
    for t in (1, 2, 90, 91):
        rows[t] = rows[t, [2, 3, 0, 1]]
    found = joint_angle_candidates(time, rows, Observation(Keypoints([0, 1])), parameters, np.full(2, 0.01))
    # The most agile ones believe anything.
    assert np.abs(np.diff(found[: len(AGILITY) // 2 + 1], axis=1)).max() < np.pi
    kept = [t for t in range(10, 200) if abs(t - 90) > 10]
    assert best(found[:, kept], angles[kept]) < 0.1


def test_gaps_are_bridged():
    time, angles = swing(200, 0.02, (1.0, 0.5))
    rows, parameters = observed(angles, Observation(Keypoints([0, 1])), noise=1e-3)
    rows[60:70] = torch.nan
    rows[100:120, :2] = torch.nan  # the elbow only: both links lose their direction
    rows[:5] = torch.nan
    rows[-5:] = torch.nan
    found = joint_angle_candidates(time, rows, Observation(Keypoints([0, 1])), parameters, np.full(2, 5e-3))
    assert np.isfinite(found).all()
    assert best(found, angles) < 0.5
    inner = best(found[:, 20:55], angles[20:55])
    assert inner < 0.05


def test_irregular_time():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.005, 0.05, size=200))
    angles = np.stack([0.8 * np.sin(2 * time), 0.5 * np.cos(3 * time)], -1)
    rows, parameters = observed(angles, Observation(Keypoints([0, 1])), noise=1e-3)
    assert (
        best(joint_angle_candidates(time, rows, Observation(Keypoints([0, 1])), parameters, np.full(2, 5e-3)), angles)
        < 0.05
    )


@pytest.mark.parametrize("middle", [(-2.9, -0.9), (3.0, 0.8), (-1.6, 2.9), (1.5, -3.0)])
def test_joints_begin_within_half_a_turn(middle):
    """Where the outer link points past half a turn and the joint does not: not a turn more, nor one less."""
    time = 0.02 * np.arange(100)
    angles = np.array(middle) + np.array([0.2, 0.3]) * np.sin(4 * time)[:, None]
    rows, parameters = observed(angles, Observation(Keypoints([0, 1])))
    found = joint_angle_candidates(time, rows, Observation(Keypoints([0, 1])), parameters, np.full(2, 1e-3))
    assert np.abs(found - angles).max(axis=(1, 2)).min() < 0.01


def test_encoders_keep_their_turns():
    """Encoders count: a jump of many turns from row to row is as measured, and no turn is dropped."""
    time, angles = swing(100, 0.02, (60.0, -90.0))
    rows, parameters = observed(angles, Observation(Encoders()))
    found = joint_angle_candidates(time, rows, Observation(Encoders()), parameters, np.full(2, 1e-3))
    assert np.abs(found - angles).max(axis=(1, 2)).min() < 0.01


def test_the_camera_fills_the_encoders_gaps_up_to_whole_turns():
    emission = Observation(Keypoints([0, 1]), Encoders())
    time, angles = swing(120, 0.02, (15.0, 4.0))  # 6 turns in all
    rows, parameters = observed(angles, emission)
    rows[40:60, 4:] = torch.nan
    measured, wrapped = link_angles(rows, emission, parameters)
    assert np.array_equal(wrapped[:, 0], (np.arange(120) >= 40) & (np.arange(120) < 60))
    assert np.abs(measured[wrapped]).max() <= np.pi
    found = joint_angle_candidates(time, rows, emission, parameters, np.full(2, 1e-3))
    assert np.abs(found - angles).max(axis=(1, 2)).min() < 0.05


def test_a_link_that_is_never_seen_gives_none():
    time, angles = swing(20, 0.02, (1.0, 0.5))
    for emission in (Observation(Keypoints([1])), Observation(Keypoints([0]))):
        rows, parameters = observed(angles, emission)
        assert joint_angle_candidates(time, rows, emission, parameters, np.full(2, 1e-3)) is None


def test_the_smoother_against_a_dense_gaussian_process():
    """No wrapping: the smoothed angles are the mean of an integrated Wiener process given the data."""
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.02, 0.2, size=25))
    measured = np.sin(3 * time)[:, None] + 0.05 * rng.normal(size=(25, 1))
    measured[7:10] = np.nan
    agility = 4.0
    found = smooth_angles(time, measured, np.array([0.05]), agility=(agility,), wrap=False)[0, :, 0]
    s, t = np.meshgrid(time - time[0], time - time[0], indexing="ij")
    low = np.minimum(s, t)
    prior = np.pi**2 + 400.0 * s * t + agility**2 * (low**2 * (3 * np.maximum(s, t) - low) / 6)
    seen = np.isfinite(measured[:, 0])
    S = prior[np.ix_(seen, seen)] + 0.05**2 * np.eye(seen.sum())
    off = measured[seen, 0] - measured[0, 0]  # it starts at the first angle that was seen
    expected = measured[0, 0] + prior[:, seen] @ np.linalg.solve(S, off)
    assert found == pytest.approx(expected, abs=1e-6)
