"""Rows that are no readings and commands of another clock, in a log of MuJoCo's arm; and logs that are clean."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from robot_log import ARM, robot_log

from invdyn.diagnosis.check.check import check
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def log() -> Recording:
    return robot_log(6.0, camera=False, damping=(0.05, 0.02)).at(slice(None, None, 5))


def strays(log: Recording) -> Recording:
    angles = np.array(log.angles)
    angles[RNG.random(len(angles)) < 0.1] = 0.0
    return replace(log, angles=angles)


def held(log: Recording) -> Recording:
    return replace(log, angles=log.angles[np.arange(len(log.time)) // 4 * 4])


def wrapped(log: Recording) -> Recording:
    middle = float(np.median(log.angles[:, 1]))
    angles = np.array(log.angles)
    angles[:, 1] = (angles[:, 1] - middle) % (2 * np.pi) + middle
    return replace(log, angles=angles)


def moved(log: Recording, by: float | np.ndarray) -> Recording:
    """The commands so much later, the first and the last held where the log has none."""
    at = np.searchsorted(log.time, log.time - by + 1e-9, side="right") - 1
    return replace(log, torques=log.torques[at.clip(0, len(log.time) - 1)])


BOTH = ("shoulder", "elbow")
SPOILT = {
    "stray": (strays, BOTH, 0.0),
    "held": (held, BOTH, 4.0),
    "wrapped": (wrapped, ("elbow",), 2 * np.pi),
    "early": (lambda log: moved(log, -0.3), (), 0.3),
    "late": (lambda log: moved(log, 0.2), (), -0.2),
    "drift": (lambda log: moved(log, 0.06 * (log.time - 1.0)), (), -0.06),
}


@pytest.mark.quick("stray", "late", "drift")
@pytest.mark.parametrize("kind", SPOILT)
def test_it_is_named_with_its_size_and_nothing_else_is(log, kind):
    spoil, joints, value = SPOILT[kind]
    (wrong,) = check(spoil(log), ARM, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == (kind if kind not in ("early", "late") else "delay", joints)
    # friction that is left free blurs a delay by some rows of 10 ms
    assert wrong.value == pytest.approx(value, rel=0.1, abs=0.025 if wrong.kind == "delay" else 1e-9)


def test_what_is_put_right_leaves_as_little_as_the_log_that_is_right(log):
    right = check(log, ARM, effects=False).unexplained
    assert check(wrapped(log), ARM, effects=False).unexplained == pytest.approx(right, rel=1e-9)
    assert check(strays(log), ARM, effects=False).unexplained < 2 * right


def test_a_delay_that_a_motor_may_have_is_left_to_the_diagnosis(log):
    assert not check(moved(log, -0.05), ARM, effects=False).mistakes


def test_a_joint_that_turns_round_and_round_is_clean_and_so_is_a_coarse_encoder():
    """64 rad, not wrapped, are no degrees: the torques bear them out."""
    time = np.arange(0, 8, 0.01)
    phase = np.sin(2 * time)
    q = np.stack([8 * time + 0.5 * phase, 0.8 * phase], -1)
    qd = np.stack([8 + np.cos(2 * time), 1.6 * np.cos(2 * time)], -1)
    qdd = np.stack([-2 * phase, -3.2 * phase], -1)
    dynamics = dynamics_for(ARM)
    torques = dynamics.inverse(*map(torch.as_tensor, (q, qd, qdd)), ARM.parameters()).numpy()
    coarse = np.round(q / 0.002) * 0.002
    for angles in (q, coarse):
        nothing = np.empty((len(time), 0, 2))
        recording = Recording(time, nothing, (), angles=angles, torques=torques, joint_names=BOTH)
        assert not check(recording, ARM, effects=False).mistakes


def test_pauses_of_the_motors_and_one_glitch_of_an_encoder_are_no_mistakes(log):
    """A motor that is off for a while commands 0; a reading that is off for one row is no wrap."""
    torques = np.array(log.torques)
    for first in range(60, 1000, 120):
        torques[first : first + 40] = 0.0
    found = check(replace(log, torques=torques), ARM, effects=False)
    assert not [wrong for wrong in found.mistakes if "another publisher" in wrong.sentence]
    angles = np.array(log.angles)
    angles[300, 1] += 5.5
    found = check(replace(log, angles=angles), ARM, effects=False)
    assert not [wrong for wrong in found.mistakes if "wrapped" in wrong.sentence]
