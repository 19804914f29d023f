"""The regression of torques against motions whose effects are known, with encoders' noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from invdyn.diagnosis.hypotheses.regression_start import start_of
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.regression.as_model import model_on, torque_missed, with_coefficients
from invdyn.diagnosis.regression.linear_effects import expected, linear_effects, required_by_file
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import hold_mean, measured_motion
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.regression.servo_gains import ServoGains, servo_gains
from invdyn.diagnosis.regression.stated_numbers import drawn, of_joints, of_links, of_others, stated
from invdyn.diagnosis.regression.weighted_fit import weighted_fit
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Link, planar_body
from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

BODY = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.4, 1.5), Link("fore", "elbow", "wrist", 0.3, 0.8)],
    gravity=(0.0, -9.81),
)
RATE = 200.0
FOUR = ("viscous_friction", "coulomb_friction", "joint_stiffness", "actuator_gain")
SAME = ServoGains(np.ones(2))


class Motion:
    """Sums of sines (T, 2), exactly."""

    def __init__(self, seed, seconds=12.0):
        rng = np.random.default_rng(seed)
        self.time = np.arange(0, seconds, 1 / RATE)
        w = 2 * np.pi * rng.uniform(0.15, 1.2, (5, 2))
        a, phase = rng.uniform(0.3, 1.0, (5, 2)) / w, rng.uniform(0, 2 * np.pi, (5, 2))
        angle = self.time[:, None, None] * w + phase
        self.q = (a * np.sin(angle)).sum(1) - np.array([1.2, 0.0])
        self.qd = (a * w * np.cos(angle)).sum(1)
        self.qdd = -(a * w**2 * np.sin(angle)).sum(1)


def recorded(seed, extra, body=BODY, noise=3e-4, torque_noise=0.05, seconds=12.0):
    """A recording of a body along such a motion with ``extra(motion)`` N·m besides."""
    motion = Motion(seed, seconds)
    rng = np.random.default_rng(seed + 1000)
    torque = inverse(dynamics_for(body), body.parameters(), motion) + extra(motion)
    torque = torque + torque_noise * rng.standard_normal(torque.shape)
    seen = motion.q + noise * rng.standard_normal(motion.q.shape)
    names = BODY.joint_names
    return Recording(motion.time, np.empty((len(seen), 0, 2)), (), angles=seen, torques=torque, joint_names=names)


def friction(m):
    return np.array([0.3, 0.1]) * m.qd + np.array([0.5, 0.25]) * np.sign(m.qd)


def found(result):
    return {(e.effect, e.place, e.parameter): e for e in result.numbers}


def shifts(motion, torques):
    """Of a plain fit of friction, by the worst torque of the tolerated size; errors of .05 N·m are small beside it."""
    found = {}
    for k, place in enumerate(BODY.joint_names):
        inverse_of = np.linalg.pinv(np.stack([motion.qd[:, k], np.sign(motion.qd[:, k])], -1))
        worst = DEFAULT.evidence.tolerance * np.sqrt((torques[:, k] ** 2).mean()) * np.abs(inverse_of).sum(1)
        found |= {(effect, place): sd for effect, sd in zip(FOUR, worst, strict=False)}
    return found


def test_friction_at_every_joint_is_two_statements():
    """With their sizes, nothing else beside them, and nearly all of the torque explained on rows not seen."""
    recording = recorded(0, friction)
    result = regress(recording, BODY)
    assert {(s.effect, s.everywhere) for s in result.stated} == {("viscous_friction", True), ("coulomb_friction", True)}
    own = found(result)
    truths = {"viscous_friction": (0.3, 0.1), "coulomb_friction": (0.5, 0.25)}
    shifted = shifts(Motion(0), recording.torques)
    for (effect, place, _), each in own.items():
        truth = truths[effect][BODY.joint_names.index(place)]
        assert each.value == pytest.approx(truth, rel=0.1)
        low, high = each.interval_90
        assert low - each.sd < truth < high + each.sd
        assert 1 < each.sd / shifted[effect, place] < 2
    assert result.torque.share > 0.9
    assert result.torque.interval_90[0] > 0.85
    assert all(s.sure == s.places for s in result.stated)
    assert max(each.probability for each in result.others) < 0.5


def test_an_effect_that_half_of_a_log_has_is_no_certainty():
    """Friction that comes at half-time, beside some that is there all along: both parts must tell the same."""

    def late(m):
        return np.array([0.0, 0.5]) * np.sign(m.qd) * (m.time > 6.0)[:, None] + np.array([0.5, 0.0]) * np.sign(m.qd)

    result = regress(recorded(4, late), BODY)
    own = {(e.effect, e.place): e.probability for e in (*result.numbers, *result.others)}
    assert own["coulomb_friction", "shoulder"] > 0.95
    assert 0.1 < own["coulomb_friction", "elbow"] < 0.9


def test_nothing_is_stated_where_nothing_lacks():
    result = regress(recorded(1, lambda m: 0.0 * m.q), BODY)
    assert result.stated == ()
    assert result.torque.share == pytest.approx(0, abs=1e-12)


def test_a_rotor_at_one_joint_is_stated_there():
    result = regress(recorded(2, lambda m: m.qdd * np.array([0.0, 0.06])), BODY)
    assert [(s.effect, s.places) for s in result.stated] == [("armature", ("elbow",))]
    assert found(result)["armature", "elbow", "inertia"].value == pytest.approx(0.06, rel=0.05)


def test_a_heavier_link_is_found_by_its_base_parameters():
    """The fore-arm's first and second moments are those of the heavier link; the mass by itself is no base's."""
    links = [BODY.links[0], Link("fore", "elbow", "wrist", 0.3, 1.2)]
    heavy = planar_body("heavy", [Link("upper", "shoulder", "elbow", 0.4, 1.5), links[1]], gravity=(0.0, -9.81))
    result = regress(recorded(3, lambda m: 0.0 * m.q, heavy), BODY)
    assert {s.effect for s in result.stated} == {"inertial_error"}
    p = heavy.parameters()
    truth = {
        "first moment": float(p.mass[1] * p.com[1]),
        "second moment": float(p.inertia[1] + p.mass[1] * p.com[1] ** 2),
    }
    own = {e.parameter: e for e in result.numbers if e.place == "fore" and e.parameter != "mass"}
    assert set(own) == set(truth)
    for name, value in truth.items():
        assert own[name].value == pytest.approx(value, rel=0.05)


@pytest.mark.long
def test_noise_in_encoders_biases_nothing():
    """Damping and dry friction over six recordings of much noise: on average within two standard errors, and 3 %."""
    values = [regress(recorded(10 + n, friction, noise=3e-3, seconds=6.0), BODY) for n in range(6)]
    for key, truth in {
        ("coulomb_friction", "shoulder", "torque"): 0.5,
        ("viscous_friction", "shoulder", "damping"): 0.3,
    }.items():
        own = np.array([found(each)[key].value for each in values])
        assert abs(own.mean() - truth) < 2 * own.std(ddof=1) / np.sqrt(6) + 0.03 * truth


def test_a_torque_that_is_not_looked_into_is_in_the_intervals():
    """Of 2 % of what the elbow needs, much like dry friction: it takes that for more of it."""
    recording = recorded(20, lambda m: friction(m) + np.array([0.0, 0.02]) * np.tanh(m.qd / 0.2), seconds=6.0)
    for tolerance, inside in ((0.0, False), (0.03, True)):
        result = regress(recording, BODY, rules=DEFAULT.replace(tolerance=tolerance))
        low, high = found(result)["coulomb_friction", "elbow", "torque"].interval_90
        assert (low < 0.25 < high) == inside


@pytest.mark.long
def test_intervals_hold_the_truth():
    """90 % intervals of four numbers in eight recordings: .7 of 32 is a binomial's chance of one in a thousand.

    Without a tolerance, and errors in sds are not small either: of t with five degrees of freedom their rms is 1.3.
    """
    hits, off = [], []
    truths = {"viscous_friction": (0.3, 0.1), "coulomb_friction": (0.5, 0.25)}
    for seed in range(20, 28):
        for each in regress(recorded(seed, friction, seconds=6.0), BODY, rules=DEFAULT.replace(tolerance=0.0)).numbers:
            if each.effect in truths:
                truth = truths[each.effect][BODY.joint_names.index(each.place)]
                hits.append(each.interval_90[0] <= truth <= each.interval_90[1])
                off.append((each.value - truth) / each.sd)
    assert len(hits) >= 28
    assert np.mean(hits) > 0.7
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 2.2


@pytest.mark.long
def test_a_free_arm_has_its_friction_and_its_masses():
    """No torque acts on a swinging arm with friction: the file's numbers stay, as a common factor of all is open."""
    from scipy.integrate import solve_ivp

    dynamics, p = dynamics_for(BODY), BODY.parameters()
    damping, dry = np.array([0.02, 0.01]), np.array([0.04, 0.02])

    def rate(_, x):
        q, qd = (torch.as_tensor(each) for each in (x[:2], x[2:]))
        push = torch.as_tensor(-damping * x[2:] - dry * np.tanh(x[2:] / 1e-3))
        return np.concatenate([x[2:], dynamics.forward(q, qd, push, p).numpy()])

    time = np.arange(0, 5, 1 / RATE)
    path = solve_ivp(rate, (0, 5), [0.2, 0.6, 0, 0], t_eval=time, rtol=1e-7, atol=1e-9, method="LSODA").y.T
    seen = path[:, :2] + 2e-4 * np.random.default_rng(0).standard_normal((len(time), 2))
    free = Recording(time, np.empty((len(time), 0, 2)), (), angles=seen, joint_names=BODY.joint_names)
    result = regress(free, BODY, passive=True)
    assert {s.effect for s in result.stated} <= {"viscous_friction", "coulomb_friction"}
    own = found(result)
    for k, joint in enumerate(BODY.joint_names):
        assert own["coulomb_friction", joint, "torque"].value == pytest.approx(dry[k], rel=0.3)


def test_an_unknown_torque_says_nothing():
    rows = Motion(0)
    seen = Recording(rows.time, np.empty((len(rows.q), 0, 2)), (), angles=rows.q, joint_names=BODY.joint_names)
    assert regress(seen, BODY) is None


def test_a_torque_is_averaged_over_the_time_that_a_row_stands_for():
    time = np.array([0.0, 1.0, 2.0, 3.0])
    mean = hold_mean(time, np.array([[1.0], [3.0], [5.0], [7.0]]), np.array([0.0, 1.0, 2.0, 3.0]))
    assert mean[:, 0].tolist() == [1.0, 2.0, 4.0, 5.0]


def test_a_gap_begins_another_stretch():
    whole = recorded(0, friction)
    rows = (whole.time < 4) | (whole.time > 7)
    motion = measured_motion(whole.at(rows), BODY)
    assert set(motion.stretch) == {0, 1}
    assert not ((motion.time > 3.99) & (motion.time < 7.01)).any()


def test_a_search_starts_where_effects_are_everywhere():
    """From friction at all joints, with its sizes; from nothing where an effect is at one joint alone."""
    friction_everywhere = recorded(0, friction, seconds=6.0)
    bound = diagnosis_problem(friction_everywhere, BODY)
    start = start_of(regress(friction_everywhere, BODY), bound, False)
    assert start.everywhere >= {"viscous_friction", "coulomb_friction"}
    assert start.values["coulomb_friction.shoulder.torque"] == pytest.approx(0.5, rel=0.1)
    keys = {effect.key for effect in start.effects}
    assert {name.rpartition(".")[0] for name in start.values} == keys
    one = recorded(2, lambda m: m.qdd * np.array([0.0, 0.06]), seconds=6.0)
    assert start_of(regress(one, BODY), bound, False).effects == ()
    assert start_of(None, bound, False).effects == ()


def test_links_that_were_found_are_those_of_the_model():
    """A heavier fore-arm: the simulation with it misses as little torque as the regression leaves."""
    links = [Link("upper", "shoulder", "elbow", 0.4, 1.5), Link("fore", "elbow", "wrist", 0.3, 1.2)]
    heavy = planar_body("heavy", links, gravity=(0.0, -9.81))
    there = regress(recorded(3, lambda m: 0.0 * m.q, heavy), BODY).unseen
    nominal = model_on(there.motion, BODY, False)
    missing, left = (
        np.sqrt((torque_missed(model, there.motion, there.cutoff) ** 2).mean(0))
        for model in (nominal, with_coefficients(nominal, there.coefficients))
    )
    assert missing == pytest.approx(np.sqrt((there.missing**2).mean(0)), rel=0.05)
    assert (left < 0.1 * missing).all()


PARTS = JointParts(damping=0.4, friction=0.2, stiffness=2.0)
FILED = replace(BODY, links=tuple(replace(link, parts=PARTS) for link in BODY.links))


def of_parts(m):
    return 0.4 * m.qd + 0.2 * np.sign(m.qd) + 2.0 * m.q


def of_a_motor(extra, gain):
    """A recording whose motors give ``gain`` times what they are told."""
    given = recorded(40, extra)
    return replace(given, torques=given.torques / gain)


def test_motors_that_give_less_are_not_friction_that_is_more():
    """The file's friction is right, and is commanded too large as all else is."""
    result = regress(of_a_motor(of_parts, 0.8), FILED)
    own = found(result)
    for joint in BODY.joint_names:
        assert own["actuator_gain", joint, "gain"].value == pytest.approx(-0.2, abs=0.02)
        for key in (("viscous_friction", joint, "damping"), ("coulomb_friction", joint, "torque")):
            assert key not in own or abs(own[key].value) < 0.02


def test_numbers_beside_a_gain_are_the_robots_own():
    result = regress(of_a_motor(lambda m: of_parts(m) + 0.3 * m.qd, 0.8), FILED)
    own = found(result)
    for joint in BODY.joint_names:
        assert own["viscous_friction", joint, "damping"].value == pytest.approx(0.3, abs=0.03)


def fitted_plainly(rows, body, kinds, others=False, tolerance=DEFAULT.evidence.tolerance):
    """Columns, and a fit of ``kinds`` at all places."""
    motion, dynamics = measured_motion(rows, body), dynamics_for(body)
    along = expected(dynamics, body, motion, False)
    rules = DEFAULT.replace(tolerance=tolerance)
    effects = linear_effects(body, motion, along, False, rules, cutoff_of(motion))
    return effects, weighted_fit(effects, motion, rules, kinds, others=others)


def by_name(numbers):
    return {(each.effect, each.place, each.parameter): each for each in numbers}


@pytest.fixture(scope="module")
def weak():
    """Motors that give .8 times what they are told, and a file's friction and springs, of which some are other."""
    rows = recorded(40, lambda m: of_parts(m) + 0.3 * m.qd - 1.0 * m.q, seconds=6.0)
    rows = replace(rows, torques=rows.torques / 0.8)
    return rows, by_name(of_joints(*fitted_plainly(rows, FILED, FOUR), SAME))


@pytest.mark.parametrize("left_out", FOUR[1:])
def test_an_effect_that_is_not_stated_has_the_numbers_that_it_would_have(weak, left_out):
    """In the robot's units, with the file's own number and all parameters; rows have weights from a fit without it."""
    rows, whole = weak
    fit = fitted_plainly(rows, FILED, tuple(kind for kind in FOUR if kind != left_out), others=True)
    others = by_name(of_others(*fit, SAME))
    assert {key for key in whole if key[0] == left_out} == {key for key in others if key[0] == left_out}
    for key in (key for key in whole if key[0] == left_out):
        own, stated_ones = others[key], whole[key]
        assert own.value == pytest.approx(stated_ones.value, abs=0.5 * stated_ones.sd)
        assert 1 / 1.6 < np.subtract(*own.interval_90) / np.subtract(*stated_ones.interval_90) < 1.6
        assert (own.unit, own.of_file) == (stated_ones.unit, stated_ones.of_file)


def test_a_torque_at_two_joints_shifts_a_links_number_by_that_of_both():
    """A column that is 1 at both: a torque of 1 N·m there is a coefficient of 1, of whose tolerance it is."""
    rows, ones = recorded(3, friction, seconds=3.0), np.ones(2)
    motion, dynamics = measured_motion(rows, BODY), dynamics_for(BODY)
    rules = DEFAULT.replace(tolerance=1.0)
    effects = linear_effects(BODY, motion, expected(dynamics, BODY, motion, False), False, rules, cutoff_of(motion))
    column = [*zip(effects.places, effects.names, strict=True)].index(("fore", "first moment"))
    values = tuple((at == column)[:, None] * np.ones(len(motion.time)) for at in effects.columns.at)
    noise = 0.3 * np.random.default_rng(0).standard_normal(motion.q.shape)
    one = replace(effects, columns=replace(effects.columns, values=values), missing=3.0 + noise, required=ones)
    fit = weighted_fit(one, motion, rules, ("inertial_error",))
    assert fit.chosen.columns == (column,)
    assert fit.shift(np.eye(1)) == pytest.approx([1.0], rel=0.1)
    assert fit.shift(np.eye(1)) >= 1.0


def test_a_links_probability_is_that_of_its_own_numbers():
    """The largest of several; and of all links', where its numbers are known with those of others alone."""
    effects, fit = fitted_plainly(recorded(3, friction, seconds=3.0), BODY, ("inertial_error",))
    numbers = of_links(effects, fit, BODY)
    upper = [replace(each, probability=0.9) for each in numbers if each.place == "upper"]
    fore = [replace(each, probability=n / 10) for n, each in enumerate(numbers) if each.place == "fore"]
    assert upper
    assert len(fore) > 1
    (each,) = stated(effects, fit, SAME, 1.0, (*upper, *fore))
    assert each.probability == {"upper": 0.9, "fore": max(e.probability for e in fore)}
    (each,) = stated(effects, fit, SAME, 1.0, upper)
    assert each.probability["fore"] == 0.9


def test_an_estimate_that_no_robot_can_have_is_its_least_value():
    """Rotors take no torque away: both are in the list, and one that would is none."""
    rows = recorded(2, lambda m: m.qdd * np.array([-0.02, 0.0]), seconds=6.0)
    effects, fit = fitted_plainly(rows, BODY, FOUR[:2], others=True)
    own = by_name(of_others(effects, fit, SAME))
    each = own["armature", "shoulder", "inertia"]
    assert each.value == 0.0
    assert each.probability < 0.5
    assert ("armature", "elbow", "inertia") in own


def test_a_files_spring_may_be_too_stiff():
    result = regress(recorded(41, lambda m: of_parts(m) - 1.0 * m.q), FILED)
    own = found(result)
    for joint in BODY.joint_names:
        each = own["joint_stiffness", joint, "stiffness"]
        assert each.value == pytest.approx(-1.0, abs=0.1)
        assert each.of_file == 2.0


def test_rows_held_out_may_be_slower():
    slow = recorded(42, friction, seconds=8.0)
    names = ("time", "keypoints", "angles", "torques")
    slower = replace(slow, **{name: getattr(slow, name)[::8] for name in names})
    assert regress(recorded(43, friction, seconds=6.0), BODY, held_out=slower).torque.share > 0.5


def test_a_joint_that_is_missing_at_first_does_not_mislead():
    whole = recorded(44, friction)
    angles = np.array(whole.angles)
    angles[: len(angles) // 3, 1] = np.nan
    result = regress(replace(whole, angles=angles), BODY)
    assert found(result)["coulomb_friction", "elbow", "torque"].value == pytest.approx(0.25, rel=0.15)
    assert result.torque.share > 0.85


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
    motion = Motion(seed, options.get("seconds", 12.0))
    # what the robot's servo gives moves it: 60 (c − q) − .4 q̇ − .1 q̇ = τ + friction
    target = halfway(motion, motion.q + (plain.torques + 0.5 * motion.qd) / 60.0)
    return replace(plain, torques=motor.gain * target), body


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


@pytest.mark.long
def test_intervals_know_that_a_servos_gain_was_estimated():
    """Errors of six logs in standard deviations: of twelve, an rms of 1.5 has a chance of one in a hundred."""
    off = {"actuator_gain": [], "viscous_friction": []}
    truths = {"actuator_gain": (1 / 40 - 1,) * 2, "viscous_friction": (0.3, 0.1)}
    for seed in range(40, 46):
        for each in regress(*servo_log(seed, 40.0, seconds=6.0)).numbers:
            if each.effect in off:
                truth = truths[each.effect][BODY.joint_names.index(each.place)]
                off[each.effect].append((each.value - truth) / each.sd)
    for every in off.values():
        assert len(every) == 12
        assert np.sqrt(np.mean(np.square(every))) < 1.5


def test_rows_in_which_a_servo_is_at_its_limit_say_nothing():
    """A third of the rows ask for more than the servo gives; friction is found by the others."""
    whole = recorded(21, friction, torque_noise=0.02)
    motion = Motion(21)
    limit = float(np.quantile(np.abs(whole.torques), 0.8))
    motor = Motor("position", 60.0, 60.0, 0.0, low=-limit, high=limit)
    parts = JointParts(motor=motor)
    body = replace(BODY, links=tuple(replace(link, parts=parts) for link in BODY.links))
    beyond = np.abs(whole.torques) > limit
    target = halfway(motion, motion.q + np.where(beyond, 3.0 * whole.torques, whole.torques) / 60.0)
    own = found(regress(replace(whole, torques=60.0 * target), body))
    assert own["coulomb_friction", "shoulder", "torque"].value == pytest.approx(0.5, rel=0.25)


@pytest.mark.parametrize("times", [1.0, 40.0])
def test_a_servos_gain_at_a_hinge_that_no_gravity_loads(times):
    """What the file asks for is there a sum of acceleration and velocity, as a rotor and damping would be."""
    motor = Motor("position", 60.0 * times, 60.0 * times, 0.4)
    plain = planar_body("one", [Link("upper", "shoulder", "elbow", 0.4, 1.5)], gravity=(0.0, 0.0))
    body = replace(plain, links=(replace(plain.links[0], parts=JointParts(damping=0.1, motor=motor)),))
    motion = Motion(3, 6.0)
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
        motion, rng = Motion(seed, 6.0), np.random.default_rng(seed)
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
    moving, body = servo_log(20, 40.0, seconds=6.0)
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
