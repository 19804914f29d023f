"""Columns that hold nothing to go by: constant, tiny, subnormal, or mostly missing."""

from dataclasses import replace

import numpy as np
import pytest
from robot_log import ARM, robot_log

from invdyn.diagnosis.check.check import check
from invdyn.recordings import Recording

SUBNORMAL = 5e-324
REMEDIES = {
    "torque sign",
    "direction",
    "angle sign",
    "zero",
    "degrees",
    "radians",
    "time",
    "exchanged",
    "scale",
    "offset",
}


@pytest.fixture(scope="module")
def log() -> Recording:
    return robot_log(2.0, camera=False).at(slice(None, None, 8))


def one(log: Recording, value: float) -> np.ndarray:
    """Zeros, but for one value."""
    column = np.zeros_like(log.torques)
    column[3, 1] = value
    return column


def seen_in(log: Recording, every: int) -> np.ndarray:
    """Angles in one row of so many."""
    angles = np.full_like(log.angles, np.nan)
    angles[::every] = log.angles[::every]
    return angles


TORQUES = {
    "one subnormal": lambda log: one(log, SUBNORMAL),
    "one tiny": lambda log: one(log, 1e-200),
    "all subnormal": lambda log: np.full_like(log.torques, SUBNORMAL),
    "tiny": lambda log: 1e-160 * log.torques,
}


@pytest.mark.quick("one subnormal", "all subnormal")
@pytest.mark.parametrize("kind", TORQUES)
def test_torques_too_small_to_move_anything_are_none(log, kind):
    found = check(replace(log, torques=TORQUES[kind](log)), ARM)
    assert found.not_looked_at == "signs, zeros, exchanged columns and gears of joints: all torques are zero"
    assert found.unexplained is None
    assert not found.excited


@pytest.mark.long
def test_a_joint_without_torque_to_speak_of_is_looked_at_with_the_others(log):
    found = check(replace(log, torques=log.torques * [1, 1e-300]), ARM)
    assert found.not_looked_at is None
    assert found.visible is not None
    assert all(np.isfinite([each.value, each.sd]).all() for each in found.excited)


@pytest.mark.quick("1.0-0.0", "None-*")
@pytest.mark.parametrize("angle", [0.0, 1.0, SUBNORMAL])
@pytest.mark.parametrize("torque", [None, 1.0])
def test_a_joint_that_does_not_move_is_accused_of_nothing(log, angle, torque):
    torques = log.torques if torque is None else np.full_like(log.torques, torque)
    still = replace(log, angles=np.full_like(log.angles, angle), torques=torques)
    assert not {wrong.kind for wrong in check(still, ARM, effects=False).mistakes} & REMEDIES


def test_of_a_joint_that_moves_and_one_that_does_not_only_one_is_accused(log):
    """An encoder that is stuck is no gear."""
    stuck = replace(log, angles=log.angles * [1, 0])
    assert all("elbow" not in wrong.joints for wrong in check(stuck, ARM, effects=False).mistakes)


def test_rows_too_few_to_tell_a_pace_by_have_no_other_unit(log):
    (wrong,) = check(replace(log, angles=seen_in(log, 40)), ARM).mistakes
    assert "4 rows with an observation" in wrong.words


@pytest.mark.parametrize("every", [2, 10, 1000])
def test_missing_angles_are_no_error(log, every):
    found = check(replace(log, angles=seen_in(log, every)), ARM)
    assert not {wrong.kind for wrong in found.mistakes} & REMEDIES
