"""What a regression of torques states of motions whose effects are known, with encoders' noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from regressed import (
    BODY,
    FILED,
    FOUR,
    RATE,
    Motion,
    found,
    friction,
    of_parts,
    recorded,
)

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, JOINT_KINDS
from invdyn.diagnosis.hypotheses.regression_start import start_of
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.regression.as_model import model_on, torque_missed, with_coefficients
from invdyn.diagnosis.regression.measured_motion import hold_mean, measured_motion
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Link, planar_body
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording


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
        assert (high - low) / each.sd == pytest.approx(2 * 2.015, rel=1e-3)  # t of five degrees of freedom
        assert 1 < each.sd / shifted[effect, place] < 2
    assert result.torque.share > 0.9
    assert result.torque.interval_90[0] > 0.85
    assert all(s.sure == s.places for s in result.stated)
    assert max(each.probability for each in result.others) < 0.5


def test_an_effect_that_half_of_a_log_has_is_no_certainty():
    """Friction that comes at half-time, beside some that is there all along: both parts must tell the same."""

    def late(m):
        return np.array([0.0, 0.5]) * np.sign(m.qd) * (m.time > 6.0)[:, None] + np.array([0.5, 0.0]) * np.sign(m.qd)

    result = regress(recorded(4, late, seconds=12.0), BODY)
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


def test_effects_that_are_left_out_are_not_named():
    """Nor have they a probability; where all are left out nothing is the answer."""
    recording = recorded(2, lambda m: m.qdd * np.array([0.0, 0.06]))
    less = regress(recording, BODY, without=("armature",))
    assert "armature" not in {each.effect for each in (*less.stated, *less.numbers, *less.others)}
    assert {each.effect for each in less.others} == set(JOINT_KINDS) - {"armature"}
    none = regress(recording, BODY, without=(*JOINT_KINDS, INERTIAL))
    assert none.stated == none.others == ()
    assert none.torque.share == pytest.approx(0, abs=1e-12)


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


@pytest.mark.slow
def test_noise_in_encoders_biases_nothing():
    """Damping and dry friction over six recordings of much noise: on average within two standard errors, and 3 %."""
    values = [regress(recorded(10 + n, friction, noise=3e-3), BODY) for n in range(6)]
    for key, truth in {
        ("coulomb_friction", "shoulder", "torque"): 0.5,
        ("viscous_friction", "shoulder", "damping"): 0.3,
    }.items():
        own = np.array([found(each)[key].value for each in values])
        assert abs(own.mean() - truth) < 2 * own.std(ddof=1) / np.sqrt(6) + 0.03 * truth


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
    some = hold_mean(time, np.array([[1.0], [np.nan], [5.0], [7.0]]), np.array([0.0, 1.0, 2.0, 3.0]))
    assert some[:, 0] == pytest.approx([1.0, np.nan, np.nan, 5.0], nan_ok=True)


def test_a_torque_that_is_missing_hides_its_own_rows_alone():
    """Of many in a row the rest are two stretches, as of a log with a gap."""
    whole = recorded(0, friction)
    times = []
    for rows in (slice(400, 401), slice(400, 500)):
        torques = whole.torques.copy()
        torques[rows, 1] = np.nan
        motion = measured_motion(replace(whole, torques=torques), BODY)
        times.append(set(measured_motion(whole, BODY).time) - set(motion.time))
        assert set(motion.stretch) == ({0} if rows.stop == 401 else {0, 1})
    assert times == [set(whole.time[400:402]), set(whole.time[400:501])]


def test_a_gap_begins_another_stretch():
    whole = recorded(0, friction, seconds=12.0)
    rows = (whole.time < 4) | (whole.time > 7)
    motion = measured_motion(whole.at(rows), BODY)
    assert set(motion.stretch) == {0, 1}
    assert not ((motion.time > 3.99) & (motion.time < 7.01)).any()


def test_a_search_starts_where_effects_are_everywhere():
    """From all that is usual, friction with its sizes; from nothing where an effect is at one joint alone."""
    friction_everywhere = recorded(0, friction)
    bound = diagnosis_problem(friction_everywhere, BODY)
    start = start_of(regress(friction_everywhere, BODY), bound)
    assert start.everywhere == {"viscous_friction", "coulomb_friction", "armature", "inertial_error"}
    assert start.values["armature.elbow.inertia"] > 0.0
    assert start.values["inertial_error.fore.mass"] == 0.0
    assert start.values["coulomb_friction.shoulder.torque"] == pytest.approx(0.5, rel=0.1)
    keys = {effect.key for effect in start.effects}
    assert {name.rpartition(".")[0] for name in start.values} == keys
    one = recorded(2, lambda m: m.qdd * np.array([0.0, 0.06]))
    assert start_of(regress(one, BODY), bound).effects == ()
    assert start_of(None, bound).effects == ()


def test_a_start_has_what_else_is_stated_and_links_where_they_are_few():
    """Springs next to what is usual, of a constant torque with its sign; no start from one joint, or links alone."""
    bound = diagnosis_problem(recorded(0, friction, seconds=2.0), BODY)
    every = list(bound.catalogue.everywhere(BODY, []))

    def start(*stated, dimensions=2, **coefficients):
        own = [SimpleNamespace(effect=e, places=("a", "b")[:n], everywhere=all_) for e, n, all_ in stated]
        body = SimpleNamespace(dimensions=dimensions)
        model = SimpleNamespace(body=body, scale=bound.model.scale)
        problem = SimpleNamespace(model=model, catalogue=SimpleNamespace(everywhere=lambda *_: every))
        found = {(effect, "elbow", "torque"): value for effect, value in coefficients.items()}
        return start_of(SimpleNamespace(stated=own, coefficients=found), problem)

    usual, links = ("viscous_friction", 2, True), ("inertial_error", 2, True)
    with_spring = start(usual, constant_torque=0.7, coulomb_friction=0.2)
    assert [effect.key for effect in with_spring.others] == ["joint_stiffness.elbow"]
    assert with_spring.values["joint_stiffness.elbow.torque"] == -0.7
    assert start(usual, coulomb_friction=0.2).others == ()
    for stated, dimensions, some in (((usual,), 2, True), ((usual,), 3, False), ((usual, links), 3, True)):
        assert ("inertial_error" in start(*stated, dimensions=dimensions).everywhere) is some
    for other in (("viscous_friction", 1, True), ("viscous_friction", 2, False), links):
        assert start(other).effects == ()


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


@pytest.mark.long
def test_motors_and_links_are_named_where_all_have_a_factor_in_common():
    """All gains and all masses times a factor would explain the torques as well: the fewest places differ."""
    rng, time, joints = np.random.default_rng(0), np.arange(0, 14, 1 / RATE), 5
    body, heavy = (
        planar_body(
            "five",
            [
                Link(f"l{k}", f"p{k}", f"p{k + 1}", 0.4 - 0.03 * k, mass if k == joints - 1 else 1.6 - 0.2 * k)
                for k in range(joints)
            ],
            gravity=(0.0, -9.81),
        )
        for mass in (0.6, 0.8)
    )
    w = 2 * np.pi * rng.uniform(0.15, 1.2, (5, joints))
    a, phase = rng.uniform(0.3, 1.0, w.shape) / w, rng.uniform(0, 2 * np.pi, w.shape)
    angle = time[:, None, None] * w + phase
    q, qd, qdd = ((a * w**n * wave).sum(1) for n, wave in enumerate((np.sin(angle), np.cos(angle), -np.sin(angle))))
    needed = inverse(dynamics_for(heavy), heavy.parameters(), SimpleNamespace(q=q, qd=qd, qdd=qdd))
    given = needed + 0.5 * np.sign(qd) + 0.2 * qd
    torque = given / [1.12, 1.0, 1.0, 0.9, 1.0] + 0.02 * rng.standard_normal(q.shape)
    seen, names = q + 1e-4 * rng.standard_normal(q.shape), body.joint_names
    log = Recording(time, np.empty((len(q), 0, 2)), (), angles=seen, torques=torque, joint_names=names)
    result = regress(log, body)
    stated = {s.effect: set(s.places) for s in result.stated}
    assert stated["actuator_gain"] == {"p0", "p3"}
    assert stated["inertial_error"] == {"l4"}
    gains = [found(result)["actuator_gain", name, "gain"].value for name in ("p0", "p3")]
    assert gains == pytest.approx([0.12, -0.1], abs=0.01)


def test_numbers_beside_a_gain_are_the_robots_own():
    result = regress(of_a_motor(lambda m: of_parts(m) + 0.3 * m.qd, 0.8), FILED)
    own = found(result)
    for joint in BODY.joint_names:
        assert own["viscous_friction", joint, "damping"].value == pytest.approx(0.3, abs=0.03)


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
    assert regress(recorded(43, friction), BODY, held_out=slower).torque.share > 0.5


def test_a_joint_that_is_missing_at_first_does_not_mislead():
    whole = recorded(44, friction)
    angles = np.array(whole.angles)
    angles[: len(angles) // 3, 1] = np.nan
    result = regress(replace(whole, angles=angles), BODY)
    assert found(result)["coulomb_friction", "elbow", "torque"].value == pytest.approx(0.25, rel=0.15)
    assert result.torque.share > 0.85
