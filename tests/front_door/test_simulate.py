"""Simulated recordings are what they claim: physics, noise of the given size, truth that belongs to them."""

import math

import numpy as np
import pytest
import torch

from invdyn.models import Link, planar_body, planar_dynamics
from invdyn.recordings import InputError
from invdyn.simulate import paper_arm, random_arm, record

BODY = planar_body(
    "arm",
    (Link("upper_arm", "shoulder", "elbow", 0.3, 1.5), Link("forearm", "elbow", "wrist", 0.25, 1.0)),
)
DYNAMICS, PARAMETERS = planar_dynamics(2), BODY.parameters()


def test_truth_obeys_the_equations_of_motion():
    _, truth = record(random_arm(BODY, duration=0.5, fps=1000, seed=1), 1)
    q, qd, tau = (torch.as_tensor(values) for values in (truth.angle, truth.velocity, truth.torque))
    step, decay = 1e-3, 5.0
    # within a step the torque decays from its value to what is expected at the end
    middle = [(values[1:] + values[:-1]) / 2 for values in (q, qd)]
    middle.append(tau[:-1] * (1 + math.exp(-decay * step)) / 2)
    expected = DYNAMICS.forward(*middle, PARAMETERS)
    assert (qd.diff(dim=0) / step - expected).abs().max() < 1e-3 * expected.abs().max()
    assert (q.diff(dim=0) / step - middle[1]).abs().max() < 1e-3 * qd.abs().max()


@pytest.mark.long
def test_keypoints_lie_around_the_true_tips_by_the_noise():
    noise = 0.02
    recording, truth = record(random_arm(BODY, duration=20, fps=25, noise=noise, seed=2), 2)
    tips = DYNAMICS.keypoints(torch.as_tensor(truth.angle), PARAMETERS).numpy()
    error = recording.keypoints - tips
    assert recording.keypoint_names == ("elbow", "wrist")
    count = error.size
    assert error.std() == pytest.approx(noise, rel=4 / math.sqrt(2 * count))
    assert abs(error.mean()) < 4 * noise / math.sqrt(count)


def test_torque_scale_is_the_torques_standard_deviation():
    model = random_arm(BODY, duration=0.1, torque_scale=0.7)
    torch.manual_seed(3)
    states, _ = model.simulate((2000,))
    torque = model.net_torque(states)
    sd = torque.std(dim=0)  # at each frame, over 2000 arms
    assert (sd - 0.7).abs().max() < 4.5 * 0.7 / math.sqrt(2 * 2000)


def test_a_command_is_the_whole_torque():
    recording, truth = record(random_arm(BODY, duration=1, commanded=True, seed=4), 4)
    assert recording.joint_names == ("shoulder", "elbow")
    np.testing.assert_array_equal(recording.torques, truth.torque)
    assert np.ptp(truth.torque, axis=0).min() > 0
    unknown, _ = record(random_arm(BODY, duration=1, seed=4), 4)
    assert unknown.torques is None
    assert unknown.joint_names == ()


def test_the_seed_decides_and_torchs_own_stays_untouched():
    torch.manual_seed(0)
    expected = torch.rand(3)
    torch.manual_seed(0)
    first, _ = record(random_arm(BODY, duration=0.5), 5)
    assert torch.equal(torch.rand(3), expected)
    again, _ = record(random_arm(BODY, duration=0.5), 5)
    other, _ = record(random_arm(BODY, duration=0.5), 6)
    np.testing.assert_array_equal(first.keypoints, again.keypoints)
    assert not np.array_equal(first.keypoints, other.keypoints)


@pytest.mark.long
def test_by_default_an_arm_swings_and_does_not_whirl():
    for seed in range(5):
        _, truth = record(random_arm(BODY, duration=3, fps=25), seed)
        swing = np.ptp(truth.angle[:, 0])
        assert 0.1 < swing < 2 * math.pi


def test_an_arm_hangs_at_the_start_along_gravity():
    sideways = planar_body("arm", BODY.links, gravity=(9.81, 0.0))
    starts = [record(random_arm(sideways, duration=0.1, seed=s), s)[1].angle[0, 0] for s in range(40)]
    assert abs(np.mean(starts)) < 4 * 0.3 / math.sqrt(40)


def test_the_papers_arm_is_the_papers():
    model = paper_arm(BODY)
    recording, truth = record(model, 0)
    assert recording.num_frames == 200
    assert recording.frame_interval == pytest.approx(0.03)
    # printed: τ_t = (1 − λδ) τ_{t−1} + δ σ η
    steps = truth.torque[1:] - (1 - 6 * 0.03) * truth.torque[:-1]
    assert steps.std() == pytest.approx(0.03 * 20, rel=4 / math.sqrt(2 * steps.size))
    # explicit Euler, ε = .01
    drift = np.diff(truth.angle, axis=0) - 0.03 * truth.velocity[:-1]
    assert drift.std() == pytest.approx(0.01, rel=4 / math.sqrt(2 * drift.size))


def test_too_short_a_recording_is_refused():
    with pytest.raises(InputError, match="at least 2"):
        random_arm(BODY, duration=0.01)
