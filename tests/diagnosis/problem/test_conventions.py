"""Signs and zeros that a robot has otherwise, on a log that another engine made."""

from dataclasses import replace

import numpy as np
import pytest
from robot_log import ARM, robot_log

from invdyn.diagnosis.check.before import check_before
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED
from invdyn.recordings import InputError

QUARTER = np.pi / 2


def mistaken(camera, angle=(1, 1), torque=(1, 1), zero=(0.0, 0.0)):
    """The log with signs and zeros changed."""
    log = robot_log(2.0, camera=camera)
    return replace(log, angles=log.angles * angle + zero, torques=log.torques * torque)


@pytest.mark.parametrize("camera", [True, False])
def test_a_log_that_is_right_is_bound(camera):
    assert diagnosis_problem(mistaken(camera), ARM).regime == COMMANDED
    assert diagnosis_problem(replace(mistaken(camera), torques=-mistaken(camera).torques), ARM, passive=True)


@pytest.mark.parametrize(
    ("camera", "mistake", "says"),
    [
        (True, {"zero": (0, QUARTER)}, "encoder of joint 'elbow' and its keypoints differ by 90° all along"),
        (True, {"zero": (-QUARTER, 0)}, "encoder of joint 'shoulder' and its keypoints differ by -90° all along"),
        (True, {"zero": (0, 0.2)}, "'elbow' and its keypoints differ by 11° all along"),
        (True, {"angle": (1, -1), "torque": (1, -1)}, "encoder of joint 'elbow' turns the other way"),
    ],
)
def test_what_a_camera_shows_is_named(camera, mistake, says):
    with pytest.raises(InputError, match=says):
        diagnosis_problem(mistaken(camera, **mistake), ARM)


@pytest.mark.parametrize(
    ("camera", "mistake", "says"),
    [
        (False, {"zero": (QUARTER, 0)}, r"'shoulder' the angles' zero is \+90° off"),
        (False, {"angle": (1, -1), "torque": (1, -1)}, "'elbow' angles and torques are counted the other way"),
        (False, {"angle": (-1, 1)}, "'shoulder' the angles are counted the other way"),
        (True, {"torque": (1, -1)}, "'elbow' the torques have the other sign"),
        (False, {"torque": (-1, -1)}, "'shoulder' and 'elbow' the torques have the other sign"),
    ],
)
def test_what_torques_show_is_named_before_a_diagnosis_begins(camera, mistake, says):
    with pytest.raises(InputError, match=says):
        check_before(mistaken(camera, **mistake), ARM)


def test_a_large_effect_is_no_mistake():
    """Friction of half the torque and a body of half the mass are for the diagnosis."""
    log = robot_log(2.0, damping=(0.0, 1.0))
    assert diagnosis_problem(log, ARM)
    assert diagnosis_problem(log, ARM.with_values(mass=[0.75, 0.5]))
