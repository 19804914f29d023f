"""Filter-and-differentiate against motions whose torques are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.inference import arm_problem
from invdyn.inference.methods.differentiate import derivatives, joint_angles, winter_cutoff
from invdyn.inference.methods.registry import differentiate
from invdyn.models import Keypoints, Link, Observation, planar_body, planar_dynamics
from invdyn.recordings import InputError, Recording

T = 200
TIME = 0.01 * np.arange(T)
ARM = planar_body(
    "arm",
    [Link("l0", "shoulder", "elbow", length=0.35, mass=1.5), Link("l1", "elbow", "wrist", length=0.3, mass=1.0)],
)
SEEN = Observation(Keypoints([0, 1])).bound(ARM)
PARAMETERS, DYNAMICS = ARM.parameters(), planar_dynamics(2)


def motion(time, rate=(4.0, 6.0), centre=(-1.2, 0.8)):
    """Angles (T, 2), and the torques that make them, by inverse dynamics."""
    rate, centre, size = np.array(rate), np.array(centre), np.array([0.5, 0.6])
    phase = rate * time[:, None]
    q, qd, qdd = centre + size * np.sin(phase), size * rate * np.cos(phase), -size * rate**2 * np.sin(phase)
    return q, DYNAMICS.inverse(*(torch.as_tensor(x) for x in (q, qd, qdd)), PARAMETERS).numpy()


def record(time=TIME, noise=0.0, **options):
    q, torque = motion(time, **options)
    tips = DYNAMICS.keypoints(torch.as_tensor(q), PARAMETERS).numpy()
    tips = tips + noise * np.random.default_rng(0).normal(size=tips.shape)
    return Recording(time=time, keypoints=tips, keypoint_names=("elbow", "wrist")), q, torque


def torques(recording, **options):
    idata = differentiate(arm_problem(recording, ARM, substeps=1), **options)
    assert idata["posterior"]["torque"].shape == (1, 1, len(recording.time), 2)
    return idata["posterior"]["torque"].values[0, 0]


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def test_torques_of_a_clean_motion():
    recording, q, torque = record()
    found = torques(recording, cutoff=20.0)
    # 1 Hz through a 20 Hz filter and differences over 10 ms: a part in a thousand, away from the ends
    assert rms((found - torque)[20:-20]) < 2e-3 * rms(torque)
    idata = differentiate(arm_problem(recording, ARM, substeps=1), cutoff=20.0)
    assert idata["posterior"]["angle"].values[0, 0] == pytest.approx(q, abs=2e-3)


def test_joints_begin_within_half_a_turn():
    recording, q, _ = record(centre=(-2.8, -0.9))  # the outer link points past half a turn
    angle, _ = joint_angles(
        TIME,
        arm_problem(recording, ARM, substeps=1).observations,
        Observation(Keypoints([0, 1])).bound(ARM),
        PARAMETERS,
    )
    assert angle == pytest.approx(q, abs=1e-6)


def test_whole_turns_of_a_whirling_arm_are_kept():
    recording, q, torque = record(rate=(4.0, 6.0), centre=(3.1, 3.0))
    angle, gap = joint_angles(
        TIME,
        arm_problem(recording, ARM, substeps=1).observations,
        Observation(Keypoints([0, 1])).bound(ARM),
        PARAMETERS,
    )
    turns = (angle - q) / (2 * np.pi)
    assert turns == pytest.approx(np.broadcast_to(np.round(turns[0]), turns.shape), abs=1e-9)
    assert not gap.any()
    assert rms((torques(recording, cutoff=20.0) - torque)[20:-20]) < 2e-3 * rms(torque)


def test_encoders_keep_the_turns_they_count():
    q = np.stack([9.0 + 3 * TIME, -7.0 + 0 * TIME], -1)
    q[50:53] = np.nan
    recording = Recording(
        time=TIME, keypoints=np.zeros((T, 0, 2)), keypoint_names=(), angles=q, joint_names=ARM.joint_names
    )
    idata = differentiate(arm_problem(recording, ARM, substeps=1), cutoff=5.0)
    # straight lines are bridged exactly
    assert idata["posterior"]["angle"].values[0, 0, 10:-10, 0] == pytest.approx(9.0 + 3 * TIME[10:-10], abs=1e-3)
    assert idata["posterior"]["angle"].values[0, 0, 10:-10, 1] == pytest.approx(-7.0, abs=1e-9)


@pytest.mark.parametrize(("cutoff", "missing"), [(5.0, False), (11.0, True)])
def test_long_gaps_are_not_bridged(cutoff, missing):
    """Six frames missing make a gap of 70 ms: half a period of 7.1 Hz."""
    recording, _, torque = record()
    keypoints = recording.keypoints.copy()
    keypoints[80:86, 1] = np.nan
    found = torques(replace(recording, keypoints=keypoints), cutoff=cutoff)
    assert np.isnan(found[80:86]).all() == missing
    assert np.isnan(found).sum() == (12 if missing else 0)
    rest = np.r_[20:75, 91:180]
    assert rms((found - torque)[rest]) < 0.1 * rms(torque)


def test_ends_are_never_made_up():
    recording, *_ = record()
    keypoints = recording.keypoints.copy()
    keypoints[:3, 0] = np.nan
    keypoints[-2:, 1] = np.nan
    idata = differentiate(arm_problem(replace(recording, keypoints=keypoints), ARM, substeps=1), cutoff=5.0)
    angle = idata["posterior"]["angle"].values[0, 0]
    # The elbow's keypoint is needed for both joints, the wrist's for the second.
    assert np.isnan(angle[:3]).all()
    assert np.isnan(angle).sum(axis=0).tolist() == [3, 5]
    assert np.isnan(idata["posterior"]["torque"].values[0, 0]).sum(axis=0).tolist() == [5, 5]


def test_irregular_time():
    time = np.cumsum(np.random.default_rng(1).uniform(0.006, 0.014, size=T))
    recording, _, torque = record(time)
    found = torques(recording, cutoff=8.0)
    assert rms((found - torque)[25:-25]) < 0.05 * rms(torque)


def test_a_command_is_part_of_the_net_torque():
    recording, _, torque = record()
    commanded = replace(recording, torques=0.5 * torque, joint_names=ARM.joint_names)
    idata = differentiate(arm_problem(commanded, ARM, substeps=1), cutoff=20.0)
    posterior = idata["posterior"]
    assert posterior["torque"].values[0, 0] == pytest.approx(torques(recording, cutoff=20.0), abs=1e-9)
    assert (posterior["torque"] - posterior["residual_torque"]).values[0, 0] == pytest.approx(0.5 * torque)


def test_residual_analysis_finds_a_sensible_cutoff():
    """Between the motion's 1 Hz and where noise takes over; lower for more noise; near the best in hindsight."""
    cutoffs = []
    for noise in (0.0005, 0.005):
        recording, _, torque = record(noise=noise)
        angle, _ = joint_angles(
            TIME,
            arm_problem(recording, ARM, substeps=1).observations,
            Observation(Keypoints([0, 1])).bound(ARM),
            PARAMETERS,
        )
        cutoffs.append(winter_cutoff(TIME, angle))
        errors = [rms((torques(recording, cutoff=f) - torque)[20:-20]) for f in (1.5, 2.5, 4.0, 6.0, 9.0, 15.0, 25.0)]
        own = rms((torques(recording) - torque)[20:-20])
        assert own < 3 * min(errors)
        assert own < 0.3 * max(errors)
    assert (cutoffs[1] < cutoffs[0]).all()
    assert ((np.array(cutoffs) > 1.0) & (np.array(cutoffs) < 20.0)).all()


def test_refusals():
    recording, *_ = record()
    with pytest.raises(InputError, match=r"between 0 and 50 Hz.*got"):
        torques(recording, cutoff=50.0)
    with pytest.raises(InputError, match="at least 10 frames, got 9"):
        derivatives(TIME[:9], np.zeros((9, 1)), 5.0)
    with pytest.raises(InputError, match="at least 10 frames, got 9"):
        winter_cutoff(TIME[:9], np.zeros((9, 1)))
    unseen = recording.keypoints.copy()
    unseen[:, 0] = np.nan
    with pytest.raises(InputError, match="link 1 of the body is never seen"):
        torques(replace(recording, keypoints=unseen), cutoff=5.0)
