"""A regression of logs whose servos have other gains than the file's."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from regressed import (
    BODY,
    RATE,
    Motion,
    found,
    friction,
    recorded,
)

from invdyn.diagnosis.regression.grouped_evidence import Chosen
from invdyn.diagnosis.regression.linear_effects import expected, linear_effects, required_by_file
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import measured_motion
from invdyn.diagnosis.regression.regress import _near, _Tried, regress
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.regression.servo_gains import ServoGains, servo_gains
from invdyn.diagnosis.regression.stated_numbers import drawn, of_joints
from invdyn.diagnosis.regression.weighted_fit import weighted_fit
from invdyn.diagnosis.rules import DEFAULT, FIXED
from invdyn.models import Link, planar_body
from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording


def halfway(motion, values):
    """Values (T, 2) half a row later, as what is constant until the next row has them in the mean."""
    later = motion.time + 0.5 / RATE
    return np.stack([np.interp(later, motion.time, each) for each in values.T], -1)


def servo_log(seed, times, **options):
    """A log of servos of 60 N·m/rad, with friction at both joints, and a file with a kp so many times theirs."""
    motor = Motor("position", 60.0 * times, 60.0 * times, 0.4, low=-1e3, high=1e3)
    parts = JointParts(damping=0.1, motor=motor)
    body = replace(BODY, links=tuple(replace(link, parts=parts) for link in BODY.links))
    plain = recorded(seed, friction, torque_noise=0.02, **options)
    motion = Motion(seed, options.get("seconds", 6.0))
    # what the robot's servo gives moves it: 60 (c − q) − .4 q̇ − .1 q̇ = τ + friction
    target = halfway(motion, motion.q + (plain.torques + 0.5 * motion.qd) / 60.0)
    return replace(plain, torques=motor.gain * target), body


@pytest.mark.quick("1.2", "40.0")
@pytest.mark.parametrize("times", [1.0, 1.2, 40.0])
def test_a_servos_gain_is_found_however_far_from_its_files(times):
    """All in the file's own units."""
    result = regress(*servo_log(20, times))
    own = found(result)
    for joint, damping, level in zip(BODY.joint_names, (0.3, 0.1), (0.5, 0.25), strict=True):
        gain = own.get(("actuator_gain", joint, "gain"))
        assert 1 + (0.0 if gain is None else gain.value) == pytest.approx(1 / times, rel=0.05)
        assert own["coulomb_friction", joint, "torque"].value == pytest.approx(level, rel=0.15)
        assert own["viscous_friction", joint, "damping"].value == pytest.approx(damping, rel=0.25)
    assert result.torque.share > 0.85


def test_a_gain_that_is_left_out_is_not_found_first_either():
    rows, body = servo_log(20, 40.0, seconds=4.0)
    without = regress(rows, body, without=("actuator_gain",))
    assert regress(rows, body).far_gains.keys() == set(BODY.joint_names)
    assert without.far_gains == {}
    assert "actuator_gain" not in {key[0] for key in without.coefficients}


@pytest.mark.long
def test_intervals_know_that_a_servos_gain_was_estimated():
    """Errors of six logs in standard deviations: of twelve, an rms of 1.5 has a chance of one in a hundred."""
    off = {"actuator_gain": [], "viscous_friction": []}
    truths = {"actuator_gain": (1 / 40 - 1,) * 2, "viscous_friction": (0.3, 0.1)}
    for seed in range(40, 46):
        for each in regress(*servo_log(seed, 40.0)).numbers:
            if each.effect in off:
                truth = truths[each.effect][BODY.joint_names.index(each.place)]
                off[each.effect].append((each.value - truth) / each.sd)
    for every in off.values():
        assert len(every) == 12
        assert np.sqrt(np.mean(np.square(every))) < 1.5


def test_rows_in_which_a_servo_is_at_its_limit_say_nothing():
    """A third of the rows ask for more than the servo gives; friction is found by the others."""
    whole = recorded(21, friction, torque_noise=0.02, seconds=12.0)
    motion = Motion(21, 12.0)
    limit = float(np.quantile(np.abs(whole.torques), 0.8))
    motor = Motor("position", 60.0, 60.0, 0.0, low=-limit, high=limit)
    parts = JointParts(motor=motor)
    body = replace(BODY, links=tuple(replace(link, parts=parts) for link in BODY.links))
    beyond = np.abs(whole.torques) > limit
    target = halfway(motion, motion.q + np.where(beyond, 3.0 * whole.torques, whole.torques) / 60.0)
    own = found(regress(replace(whole, torques=60.0 * target), body))
    assert own["coulomb_friction", "shoulder", "torque"].value == pytest.approx(0.5, rel=0.25)


def test_a_stiff_servo_goes_from_limit_to_limit_within_a_row():
    """Its mean torque over a row, against that of 20,000 moments; of the mean demand alone it is far off."""
    motor = Motor("position", 900.0, 900.0, 2.0, low=-3.0, high=4.0)
    plain = planar_body("one", [Link("upper", "shoulder", "elbow", 0.4, 1.5)], gravity=(0.0, 0.0))
    body = replace(plain, links=(replace(plain.links[0], parts=JointParts(motor=motor)),))
    time = np.arange(300) / RATE
    target = 0.4 * np.sin(3.0 * time)[:, None] + 0.004
    rows = Recording(time, np.empty((300, 0, 2)), (), None, target - 0.004, 900.0 * target, ("shoulder",))
    seen = measured_motion(rows, body)
    off = []
    for t, mean, given in zip(seen.time[5:-5], seen.demanded[5:-5, 0], seen.torque[5:-5, 0], strict=True):
        at = t + (np.arange(20000) + 0.5) / 20000 / RATE - 0.5 / RATE
        held = target[np.floor(at * RATE + 1e-9).astype(int), 0]
        exact = np.clip(900.0 * (held - 0.4 * np.sin(3.0 * at)) - 2.4 * np.cos(3.0 * at), -3.0, 4.0).mean()
        off.append((given - exact, np.clip(mean - 2.4 * np.cos(3.0 * t), -3.0, 4.0) - exact))
    exact, of_mean = np.sqrt(np.mean(np.square(off), 0))
    assert exact < 0.05
    assert of_mean > 10 * exact


def test_a_gain_stays_only_where_it_leaves_less_of_what_a_servo_gives():
    """The second leaves as large a share as the file's, the third more than the file alone; the fourth is its own.

    The fifth leaves as much as a fit about the file's gain that finds it far off, too. Of a robot most of whose servos
    are far from their file's, one that leaves as large a share is, too.
    """
    count = 10
    known = SimpleNamespace(kinds=("viscous_friction",) * count + ("actuator_gain",), places=(*"abcdefghij", "e"))
    fit = SimpleNamespace(chosen=Chosen(columns=tuple(range(count + 1)), values=np.array([0.0] * count + [8.0])))

    def tried(factor, left, given):
        rows = np.ones((8, count))
        unseen = SimpleNamespace(given=np.array(given), of_file=2.0 * rows)
        return _Tried(known, unseen, ServoGains(np.array(factor)), np.zeros(count), [fit], [rows * left], 0)

    filed = tried([1.0] * 10, [1.0, 1.0, 9.0, 1.0, 1.0] + [1.0] * 5, [4.0] * 10)
    left, given = [0.1, 0.25, 3.0, 1.0, 0.25] + [1.0] * 5, [1.0, 1.0, 2.0, 4.0, 1.0] + [4.0] * 5
    about = tried([9.0, 9.0, 9.0, 1.0, 9.0] + [1.0] * 5, left, given)
    assert about.no_better_than(filed).tolist() == [False, True, True, False, False] + [False] * 5
    most = tried([9.0, 9.0, 9.0, 1.0, 9.0] + [9.0] * 5, left[:5] + [0.1] * 5, given[:5] + [1.0] * 5)
    assert most.no_better_than(filed).tolist() == [False, False, True, False, False] + [False] * 5


def test_a_gain_found_first_stays_within_what_a_regression_about_it_takes():
    """A factor of that many times, and no more; the gain of another joint keeps its own bound."""
    rows, body = servo_log(20, 1.0)
    seen = measured_motion(rows, body)
    effects = linear_effects(body, seen, expected(dynamics_for(body), body, seen, False), False, DEFAULT, np.inf)
    least = _near(effects, ServoGains(np.array([9.0, 1.0]))).least
    changed = [(effects.kinds[p], effects.places[p]) for p in np.flatnonzero(least != effects.least)]
    assert changed == [("actuator_gain", body.joint_names[0])]
    (own,) = least[least != effects.least]
    assert -np.log1p(own) == pytest.approx(FIXED.linear_servo_gain)


def test_a_servo_at_its_limits_gives_no_more_with_another_gain(monkeypatch):
    """Before any filter its column is what the file asks for elsewhere, and nothing there; others are whole."""
    rows, body = servo_log(20, 1.0)
    stops = replace(body.links[0].parts, motor=replace(body.links[0].parts.motor, low=-2.0, high=2.0))
    body = replace(body, links=(replace(body.links[0], parts=stops), body.links[1]))
    seen = measured_motion(rows, body)
    along = expected(dynamics_for(body), body, seen, False)
    monkeypatch.setattr("invdyn.diagnosis.regression.linear_effects.low_passed", lambda values, *_: values)
    effects = linear_effects(body, seen, along, False, DEFAULT, np.inf)
    names = list(zip(effects.kinds, effects.places, strict=True))
    for k, joint in enumerate(body.joint_names):
        there = effects.usable[:, k]
        gain = effects.columns.of(names.index(("actuator_gain", joint)), k)
        assert (0.1 < there.mean() < 0.9) == (k == 0)
        assert gain == pytest.approx(np.where(there, along.required[:, k], 0.0), abs=1e-9)
        assert effects.columns.of(names.index(("viscous_friction", joint)), k) == pytest.approx(seen.qd[:, k], abs=1e-9)


@pytest.mark.parametrize("times", [1.0, 40.0])
def test_a_servos_gain_at_a_hinge_that_no_gravity_loads(times):
    """What the file asks for is there a sum of acceleration and velocity, as a rotor and damping would be."""
    motor = Motor("position", 60.0 * times, 60.0 * times, 0.4)
    plain = planar_body("one", [Link("upper", "shoulder", "elbow", 0.4, 1.5)], gravity=(0.0, 0.0))
    body = replace(plain, links=(replace(plain.links[0], parts=JointParts(damping=0.1, motor=motor)),))
    motion = Motion(3, 3.0)
    for name in ("q", "qd", "qdd"):
        setattr(motion, name, getattr(motion, name)[:, :1])
    given = inverse(dynamics_for(plain), plain.parameters(), motion) + 0.5 * motion.qd
    target = np.interp(motion.time + 0.5 / RATE, motion.time, (motion.q + given / 60.0)[:, 0])[:, None]
    angles = motion.q + 3e-4 * np.random.default_rng(0).standard_normal(motion.q.shape)
    rows = Recording(motion.time, np.empty((len(angles), 0, 2)), (), None, angles, motor.gain * target, ("shoulder",))
    seen = measured_motion(rows, body)
    gains = servo_gains(seen, required_by_file(dynamics_for(body), body, seen), body)
    assert gains.factor == pytest.approx([times], rel=0.01)
    assert (
        servo_gains(measured_motion(rows, body, passive=True), seen.q, body).factor == 1.0
    )  # no torque: nothing to say


@pytest.mark.long
def test_a_servos_gain_that_explains_less_than_the_files_is_dropped():
    """A fore-arm twice as heavy, moved so that the shoulder needs no torque: a weak servo, until it moves otherwise."""
    parts = JointParts(damping=0.1, motor=Motor("position", 60.0, 60.0, 0.4))

    def body(mass, own=None):
        links = [
            Link("upper", "shoulder", "elbow", 0.4, 1.5, parts=own),
            Link("fore", "elbow", "wrist", 0.3, mass, parts=own),
        ]
        return planar_body("arm", links, gravity=(0.0, 0.0))

    def log(seed, mix):
        motion, rng = Motion(seed), np.random.default_rng(seed)
        for name in ("q", "qd", "qdd"):
            setattr(motion, name, getattr(motion, name) @ mix)
        given = inverse(dynamics_for(body(1.6)), body(1.6).parameters(), motion)
        given = given + 0.02 * rng.standard_normal(given.shape)
        target = halfway(motion, motion.q + (given + 0.5 * motion.qd) / 60.0)
        seen = motion.q + 3e-4 * rng.standard_normal(given.shape)
        return Recording(motion.time, np.empty((len(seen), 0, 2)), (), None, seen, 60.0 * target, BODY.joint_names)

    told, other = log(3, np.array([[0.0, 0.0], [-0.37, 1.0]])), log(5, np.eye(2))
    seen, filed = measured_motion(told, body(0.8, parts)), body(0.8, parts)
    assert servo_gains(seen, required_by_file(dynamics_for(filed), filed, seen), filed).factor[0] < 0.1
    result = regress(told, filed, held_out=other)
    assert result.far_gains == {}
    assert result.torque.share > 0.8


@pytest.mark.parametrize(("true", "expected"), [((50.0, 40.0, -1.0), 44.7), ((50.0, 1.0, -1.0), 1.0)])
def test_a_servo_that_the_log_does_not_show_is_like_most_others(true, expected):
    """Of the third joint no positive gain fits; it takes the median of the others where most of all are far off."""
    rng = np.random.default_rng(0)
    required, qd, qdd = rng.standard_normal((3, 400, 3))
    seen = SimpleNamespace(qd=qd, qdd=qdd, demanded=required * true, servo_drag=np.zeros((400, 3)))
    body = SimpleNamespace(joint_parts=[JointParts(motor=Motor("position", 60.0, 60.0))] * 3, num_joints=3)
    assert servo_gains(seen, required, body).factor[2] == pytest.approx(expected, rel=0.01)


def test_a_joint_at_rest_in_the_longest_recording_has_no_frequency():
    moving, body = servo_log(20, 40.0, seconds=3.0)
    longer, _ = servo_log(21, 40.0)
    resting = replace(longer, angles=longer.angles * [1.0, 0.0])
    assert resting.num_frames > moving.num_frames
    assert cutoff_of(measured_motion([moving, resting], body)) > 0


def test_a_servo_that_cannot_have_moved_the_arm_explains_nothing():
    """A third of the rows ask for more than its limit; there it gives that, whatever is fitted to the others."""
    rows, body = servo_log(20, 1.0)
    assert regress(rows, body).torque.share > 0.95
    links = [
        replace(link, parts=replace(link.parts, motor=replace(link.parts.motor, low=-2.0, high=2.0)))
        for link in body.links
    ]
    assert regress(rows, replace(body, links=tuple(links))).torque.share < 0.1


def test_numbers_in_the_torque_of_a_servo_of_unknown_gain_are_as_unsure_as_that():
    """Without the gain among the columns, an sd of one of its logarithm goes into all of the joint, by one factor."""
    rows, body = servo_log(20, 40.0)
    motion, dynamics = measured_motion(rows, body), dynamics_for(body)
    far = ServoGains(np.array([40.0, 40.0]))
    along = expected(dynamics, body, motion, False)
    effects = linear_effects(body, motion, along, False, DEFAULT, cutoff_of(motion), far.factor)
    fit = weighted_fit(effects, motion, DEFAULT.replace(tolerance=0.0), ("viscous_friction", "coulomb_friction"))
    numbers = {(each.effect, each.place): each for each in of_joints(effects, fit, far)}
    gain = numbers["actuator_gain", "elbow"]
    assert 1 + gain.value == pytest.approx(1 / 40)
    assert gain.sd == pytest.approx(1 + gain.value)
    dry = numbers["coulomb_friction", "elbow"]
    assert dry.probability > 0.99
    wide = np.exp(1.645 * np.array([-1.0, 1.0]))
    assert np.divide(dry.interval_90, dry.value) == pytest.approx(wide, rel=0.1)
    assert np.array(gain.interval_90) + 1 == pytest.approx(wide / 40, rel=0.1)
    draws = drawn(effects, fit, far)
    log = np.log([1 + each["actuator_gain", "elbow", "gain"] for each in draws]) + np.log(40.0)
    assert log.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * len(log)))
    moved = np.array([each["coulomb_friction", "elbow", "torque"] for each in draws])
    large = numbers["coulomb_friction", "elbow"].value
    assert large > 0
    np.testing.assert_allclose(moved / large, np.exp(log), rtol=0.1)
