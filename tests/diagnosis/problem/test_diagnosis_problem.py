"""A recording bound to a simulation: what it must show."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import ARM

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.problem.diagnosis_problem import NotEnoughData, diagnosis_problem
from invdyn.simulate import random_arm, record


@pytest.fixture(scope="module", params=[False, True], ids=["torque unknown", "commanded"])
def recording(request):
    """Two links; elbow and wrist are tracked."""
    return record(random_arm(ARM, duration=1.5, fps=30, noise=0.003, commanded=request.param, seed=0), 0)[0]


def hand_alone(recording):
    return replace(recording, keypoints=recording.keypoints[:, 1:], keypoint_names=recording.keypoint_names[1:])


def test_a_hand_alone_shows_a_pose_where_torques_are_known(recording):
    alone = hand_alone(recording)
    lost = replace(recording, keypoints=np.where([[[True], [False]]], np.nan, recording.keypoints))
    if recording.torques is None:
        for less in (alone, lost):
            with pytest.raises(NotEnoughData, match=r"keypoint elbow is not tracked.*encoders"):
                diagnosis_problem(less, ARM)
    else:
        assert diagnosis_problem(alone, ARM).model.observation.keypoints.sites == (1,)
        assert diagnosis_problem(lost, ARM).model.observation.keypoints.sites == (0, 1)
    encoded = replace(alone, angles=np.zeros((alone.num_frames, 2)), joint_names=ARM.joint_names)
    assert diagnosis_problem(encoded, ARM).regime.knows_torque == (recording.torques is not None)


def test_what_is_missing_is_an_answer(recording):
    if recording.torques is None:
        said = diagnose(hand_alone(recording), ARM)
        assert "track it too" in said.not_enough_data
        assert not said.causes
