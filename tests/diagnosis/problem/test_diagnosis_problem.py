"""A recording bound to a simulation: what it must show."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import ARM

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.problem.diagnosis_problem import NotEnoughData, diagnosis_problem
from invdyn.simulate import random_arm, record


def recorded(commanded):
    """Two links; elbow and wrist are tracked."""
    return record(random_arm(ARM, duration=1.5, fps=30, noise=0.003, commanded=commanded, seed=0), 0)[0]


def hand_alone(recording):
    return replace(recording, keypoints=recording.keypoints[:, 1:], keypoint_names=recording.keypoint_names[1:])


def elbow_lost(recording):
    return replace(recording, keypoints=np.where([[[True], [False]]], np.nan, recording.keypoints))


def encoded(recording):
    return replace(recording, angles=np.zeros((recording.num_frames, 2)), joint_names=ARM.joint_names)


@pytest.mark.parametrize("less", [hand_alone, elbow_lost])
def test_without_torques_a_hand_alone_is_too_little(less):
    with pytest.raises(NotEnoughData, match=r"keypoint elbow is not tracked.*encoders"):
        diagnosis_problem(less(recorded(False)), ARM)
    said = diagnose(less(recorded(False)), ARM)
    assert "track it too" in said.not_enough_data
    assert not said.causes


@pytest.mark.parametrize(("commanded", "known"), [(True, False), (False, True), (True, True)])
def test_torques_or_encoders_tell_the_pose(commanded, known):
    hand = hand_alone(recorded(commanded))
    bound = diagnosis_problem(encoded(hand) if known else hand, ARM)
    assert bound.regime.knows_torque == commanded
    assert bound.model.observation.keypoints.sites == (1,)
