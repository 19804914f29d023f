"""Commands at other times: rows whose command the log does not have are unknown, and are left out."""

from types import SimpleNamespace

import numpy as np
import pytest

from invdyn.diagnosis.check.check import check
from invdyn.diagnosis.check.command_times import shifted
from invdyn.diagnosis.check.torque_regression import smoothed
from invdyn.models import Link, planar_body
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.recordings import Recording

TIME, NONE = np.arange(5.0), np.nan
COMMANDS = np.stack([10 + TIME, 20 + TIME], -1)


def test_a_command_that_the_log_does_not_have_is_unknown():
    np.testing.assert_array_equal(shifted(TIME, COMMANDS, 1.0)[:, 0], [NONE, 10, 11, 12, 13])
    np.testing.assert_array_equal(shifted(TIME, COMMANDS, -2.0)[:, 0], [12, 13, 14, NONE, NONE])
    one = shifted(TIME, COMMANDS, 1.0, (1,))
    np.testing.assert_array_equal(one[:, 0], COMMANDS[:, 0])
    np.testing.assert_array_equal(one[:, 1], [NONE, 20, 21, 22, 23])


def test_times_in_another_unit_are_put_right():
    body, time = SimpleNamespace(joint_parts=[NOTHING] * 2), 0.01 * np.arange(300)
    angle = np.stack([np.sin(3 * time), np.cos(2 * time)], -1)
    own, wrong = (smoothed(body, unit * time, angle, angle, 9) for unit in (1.0, 1024.0))
    right = wrong.in_time(1 / 1024)
    for name in ("q", "qd", "qdd"):
        np.testing.assert_allclose(getattr(right, name), getattr(own, name), rtol=1e-9, atol=1e-9)


def test_a_motion_has_no_row_that_an_unknown_command_is_part_of():
    """One that took a missing number for zero would be less than the ramp."""
    time = 0.01 * np.arange(300)
    ramp = np.stack([time, 2 - time], -1)
    motion = smoothed(SimpleNamespace(joint_parts=[NOTHING] * 2), time, ramp, ramp, 9)
    moved = motion.recommanded(np.where(time[:, None] < 0.5, np.nan, ramp))
    assert 0 < len(motion.q) - len(moved.q) < 60
    assert moved.q[0, 0] > 0.5
    np.testing.assert_allclose(moved.torque, motion.torque[-len(moved.q) :], atol=1e-9)


def test_seconds_since_1970_shift_the_same_rows():
    time, commands = 0.02 * np.arange(40), np.random.default_rng(0).normal(size=(40, 2))
    for delay in (0.06, -0.14):
        np.testing.assert_array_equal(shifted(1.7e9 + time, commands, delay), shifted(time, commands, delay))


def of_a_pendulum(seed, drift=0.0, ripple=0.0):
    """The log of a bar that a motor moves in two slow sines, and the bar."""
    rng, time = np.random.default_rng(seed), np.arange(500) / 60
    rate, phase = 2 * np.pi * rng.uniform(0.1, 0.3, 2), rng.uniform(0, 6.28, 2)
    begin = rng.uniform(0, 6.28)

    def angle(t):
        return 0.45 * np.sin(np.outer(t, rate) + phase).sum(1) - 1.2

    sent = (1 + drift) * time
    acceleration = -0.45 * (rate**2 * np.sin(np.outer(sent, rate) + phase)).sum(1)
    torque = acceleration / 12 + 9.81 / 4 * np.cos(angle(sent)) + ripple * np.sin(4 * angle(sent) + begin)
    seen = angle(time) + 3e-4 * rng.standard_normal(len(time))
    body = planar_body("pendulum", [Link("bar", "pivot", "tip", length=0.5, mass=1.0)])
    own = {"angles": seen[:, None], "torques": torque[:, None], "joint_names": ("pivot",)}
    return Recording(time, np.empty((len(time), 0, 2)), (), **own), body


@pytest.mark.parametrize(("seed", "ripple"), [(22, 0.9), (36, 0.9), (16, 0.5), (54, 0.9)])
def test_a_ripple_is_no_clock(seed, ripple):
    """Slow motions of few independent values, which a late command may fit, and in the last a window without a row."""
    found = check(*of_a_pendulum(seed, ripple=ripple), effects=False)
    assert not {each.kind for each in found.mistakes} & {"drift", "delay"}


def test_a_clock_that_drifts_is_found_in_few_values():
    (found,) = check(*of_a_pendulum(1, drift=0.04), effects=False).mistakes
    assert found.kind == "drift"
    assert found.value == pytest.approx(1 - 1 / 1.04, abs=0.01)
