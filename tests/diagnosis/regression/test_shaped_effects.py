"""Torques of effects with a shape along a motion, and which shape and which effect a regression finds."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from regressed import BODY, found, recorded
from trees import panda

import invdyn.diagnosis.regression.regress as regress_module
from invdyn.diagnosis.catalogue.linear_laws import ODD
from invdyn.diagnosis.regression.columns import Columns
from invdyn.diagnosis.regression.linear_effects import expected_sign
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import measured_motion
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.regression.shape_profile import Context, _explained
from invdyn.diagnosis.regression.shaped_effects import Along, shaped_effects, sizes_of
from invdyn.diagnosis.regression.weighted_fit import weighted_fit
from invdyn.diagnosis.rules import FIXED
from invdyn.models import Body, Link, planar_body, write_mjcf
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import Recording

SLOW = 0.3  # rad/s


@pytest.fixture(scope="module")
def along():
    motion = measured_motion(recorded(0, lambda m: 0 * m.q), BODY)
    return Along(BODY, dynamics_for(BODY), motion, expected_sign(motion))


def columns(along, name, value, place="elbow"):
    (one,) = [e for e in shaped_effects(BODY, along.motion, False) if e.key == (name, place)]
    return [column.numpy() for column in along.columns(one, value)]


def test_friction_that_falls_with_speed_is_linear_in_its_two_levels(along):
    speed, sign = along.motion.qd[:, 1], along.sign.numpy()[:, 1]
    slow = np.exp(-((speed / SLOW) ** 2))
    for column, own in zip(columns(along, "stribeck_friction", SLOW), (sign * (1 - slow), sign * slow), strict=True):
        np.testing.assert_allclose(column[:, 1], own, rtol=1e-12, atol=1e-12)
        assert not column[:, 0].any()


def test_an_encoders_offset_asks_for_the_torque_of_other_angles_at_all_joints(along):
    offset = 0.02
    (column,) = columns(along, "encoder_offset", offset)
    m = along.motion
    true = type("True", (), {"q": m.q - [0.0, offset], "qd": m.qd, "qdd": m.qdd})
    other = inverse(along.dynamics, BODY.parameters(), true) - inverse(along.dynamics, BODY.parameters(), m)
    np.testing.assert_allclose(column * offset, other, rtol=1e-9, atol=1e-12)


def test_a_delay_is_what_the_command_was_before(along):
    """Of as many whole rows."""
    step, m = float(np.diff(along.motion.time)[0]), along.motion
    (column,) = columns(along, "actuator_delay", 3 * step)
    np.testing.assert_allclose(3 * step * column[3:, 1], m.command[3:, 1] - m.command[:-3, 1], rtol=1e-6, atol=1e-6)


def test_a_motors_limit_takes_what_is_commanded_beyond_it(along):
    u = along.motion.command[:, 1]
    limit = 0.5 * np.abs(u).max()
    (column,) = columns(along, "actuator_saturation", limit)
    np.testing.assert_allclose(column[:, 1], u - u.clip(-limit, limit), rtol=1e-9, atol=1e-9)


def test_a_command_is_expected_where_the_file_says_as_far_as_its_log_is_noisy(along):
    true, noise = along.filed(along.qdd).numpy(), np.random.default_rng(0).standard_normal(along.q.shape)
    for scale, closest in ((0.0, 1.0), (5.0, 0.3)):
        motion = replace(along.motion, command=along.motion.command + scale * noise)
        found = Along(BODY, along.dynamics, motion, along.sign.numpy()).expected_command.mean.numpy()
        weight = (found - true) / (motion.command - true)
        np.testing.assert_allclose(weight, weight[:1].repeat(len(weight), 0), rtol=1e-6)
        assert ((weight[0] > 0.9) if scale == 0.0 else (weight[0] < closest)).all()


def test_a_spring_between_joints_and_a_stop_are_linear_in_their_stiffness(along):
    q, ratio, angle = along.motion.q, 0.5, float(np.median(along.motion.q[:, 1]))
    stiffness, torque = columns(along, "joint_coupling", ratio, "shoulder.elbow")
    arms = np.array([-ratio, 1.0])
    np.testing.assert_allclose(stiffness, (q @ arms)[:, None] * arms, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(torque, np.broadcast_to(-arms, q.shape), rtol=1e-9)
    pressed, _ = columns(along, "joint_limit", angle, "elbow.upper")
    np.testing.assert_allclose(pressed[:, 1], (q[:, 1] - angle).clip(0.0), rtol=1e-9, atol=1e-9)


def test_what_columns_explain_is_what_they_take_from_the_weighted_ridge_sum():
    rng = np.random.default_rng(0)
    X, Z = rng.standard_normal((2, 3, 50)), rng.standard_normal((2, 50, 1))
    columns = Columns((np.concatenate(X)[:4],), (np.arange(4),), 4)
    y, weights, size = rng.standard_normal((50, 1)), rng.uniform(0.5, 2.0, (50, 1)), np.array([1.0, 2.0, 0.5, 3.0])
    gain, values = Context(columns, np.arange(4), size, y, weights).explains(Z, np.array([0.7, 1.3]))

    def least(columns, sd):
        root = np.sqrt(weights)
        whole, zero = np.concatenate([columns.T * root, np.diag(1 / sd)]), np.zeros((len(sd), 1))
        best, left, *_ = np.linalg.lstsq(whole, np.concatenate([y * root, zero]), rcond=None)
        return best[:, 0], float(left[0])

    every, both = np.concatenate([columns.values[0], Z[:, :, 0]]), np.append(size, [0.7, 1.3])
    best, after = least(every, both)
    assert gain == pytest.approx((least(columns.values[0], size)[1] - after) / 2, rel=1e-10)
    np.testing.assert_allclose(values, best[-2:], rtol=1e-10)
    assert sizes_of(2.0 * Z, np.ones(1)) == pytest.approx(0.5 / np.sqrt((Z**2).mean((1, 2))))


def test_a_shape_whose_coefficients_are_below_their_least_explains_nothing(along):
    """A motor's limit takes torque away, and gives none."""
    (limit,) = [e for e in shaped_effects(BODY, along.motion, False) if e.key == ("actuator_saturation", "elbow")]
    rows, joints = along.motion.q.shape
    column = columns(along, "actuator_saturation", value := 0.5 * np.abs(along.motion.command[:, 1]).max())[0]
    other = Columns((np.ones((1, rows)), np.zeros((0, rows))), (np.arange(1), np.arange(0)), 1)
    known = SimpleNamespace(usable=1.0, cutoff=cutoff_of(along.motion), unit=np.ones(joints))
    for sign, explains in ((1, True), (-1, False)):
        context = Context(other, np.arange(1), np.ones(1), sign * column, np.ones((rows, joints)))
        gain, _ = _explained(context, limit, along, known, np.ones(joints), value)
        assert (gain > 0) is explains


@pytest.mark.long
def test_stribeck_friction_is_named_with_its_speed_and_coulomb_friction_is_not_taken_for_it():
    """Levels and speed are in intervals twice as wide as the 90 % ones."""
    true = {"coulomb": 0.2, "static": 0.6, "velocity": 0.4}

    def rubs(m):
        slow = np.exp(-((m.qd / true["velocity"]) ** 2))
        return np.array([0.0, 1.0]) * (true["coulomb"] + (true["static"] - true["coulomb"]) * slow) * np.sign(m.qd)

    result = regress(recorded(0, rubs), BODY)
    assert [(s.effect, s.sure) for s in result.stated] == [("stribeck_friction", ("elbow",))]
    for (_, _, name), each in found(result).items():
        low, high = each.interval_90
        assert abs(each.value - true[name]) < high - low
        assert each.value == pytest.approx(true[name], rel=0.15)
    plain = regress(recorded(0, lambda m: np.array([0.0, 0.4]) * np.sign(m.qd)), BODY)
    assert [(s.effect, s.sure) for s in plain.stated] == [("coulomb_friction", ("elbow",))]


@pytest.mark.long
def test_a_spring_between_joints_is_named_beside_friction_at_all_joints(monkeypatch):
    arms = np.array([-0.6, 1.0])
    made = recorded(0, lambda m: 0.3 * m.qd + 0.2 * np.sign(m.qd) + 2.0 * (m.q @ arms - 1.0)[:, None] * arms)
    fits = []

    def fitted(known, motion, rules, plain, *before, **options):
        fit = weighted_fit(known, motion, rules, plain, *before, **options)
        fits.append((plain, fit.chosen.statements))
        return fit

    monkeypatch.setattr(regress_module, "weighted_fit", fitted)
    assert {s.effect: s.sure for s in regress(made, BODY).stated}["joint_coupling"] == ("shoulder.elbow",)
    alone = {s.kind for plain, statements in fits if plain is None for s in statements}
    beside = [s for plain, statements in fits if plain is not None and "joint_coupling" in plain for s in statements]
    assert not alone & {*ODD}, "chosen one by one these imitate what is usual"
    assert {s.size for s in beside if s.kind in ODD} == {FIXED.odd_size}


PENDULUM = planar_body("arm", [Link("arm", "pivot", "tip", 0.5, 0.5)], gravity=(0.0, -9.81))


def swung(seed, law, noise=None, seconds=8.0, rate=200.0):
    """A log of a pendulum with Coulomb friction whose motor follows sines; ``noise`` (R,) times the torque's sd."""
    rng, p = np.random.default_rng(seed), PENDULUM.parameters()
    lever = float(p.mass[0] * p.com.ravel()[0])
    inertia = float(p.inertia.ravel()[0] + lever * p.com.ravel()[0])
    w, phase = 2 * np.pi * rng.uniform(0.2, 1.2, 5), rng.uniform(0, 6, 5)
    a, time = 1.5 * rng.uniform(0.5, 1.0, 5) / w, np.arange(0, seconds, 1 / rate)
    goals = np.sin(time[:, None] * w + phase) @ a, np.cos(time[:, None] * w + phase) @ (a * w)
    q, qd, seen, torque = float(goals[0][0]), float(goals[1][0]), [], []
    for goal, speed in zip(*goals, strict=True):
        u = 12 * (goal - q) + (speed - qd) + 9.81 * lever * np.sin(q)
        seen.append(q)
        torque.append(u)
        for _ in range(10):
            qd += (law(u) - 9.81 * lever * np.sin(q) - 0.05 * np.tanh(100 * qd)) / inertia / rate / 10
            q += qd / rate / 10
    angles = np.array(seen) - np.pi / 2 + 3e-4 * rng.standard_normal(len(time))
    given = np.array(torque) + (0.0 if noise is None else noise * np.std(torque))
    nothing = np.empty((len(time), 0, 2))
    pairs = {"angles": angles[:, None], "torques": given[:, None]}
    return Recording(time, nothing, (), **pairs, joint_names=PENDULUM.joint_names)


def of_motors(log):
    """Effects of motors that are sure, and their numbers."""
    result = regress(log, PENDULUM)
    sure = {s.effect for s in result.stated if s.sure} & {"actuator_saturation", "actuator_deadzone"}
    return sure, {e.parameter: e.value for e in result.numbers}


@pytest.mark.long
def test_noise_in_a_torque_is_not_taken_for_a_limit_or_a_dead_zone():
    """Spikes, which both take away."""
    assert of_motors(swung(0, lambda u: u, np.random.default_rng(7).standard_t(2, 1600)))[0] == set()


@pytest.mark.long
def test_limits_and_dead_zones_keep_their_names_and_numbers():
    noise = 0.3 * np.random.default_rng(7).standard_normal((3, 1600))
    for seed, most in ((0, 0.9), (2, 0.58)):
        sure, found = of_motors(swung(seed, lambda u, most=most: min(max(u, -most), most)))
        assert sure == {"actuator_saturation"}
        assert found["limit"] == pytest.approx(most, rel=0.05)
    for seed, width in ((0, 0.1), (1, 0.06), (2, 0.07)):
        sure, found = of_motors(swung(seed, lambda u, d=width: u - min(max(u, -d), d), noise[seed]))
        assert sure == {"actuator_deadzone"}
        assert found["width"] == pytest.approx(width, rel=0.3)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """A Panda with seven position servos."""
    path = tmp_path_factory.mktemp("panda") / "panda.xml"
    write_mjcf(panda(), path)
    servos = "".join(
        f'<general joint="{name}" biastype="affine" gainprm="400" biasprm="0 -400 -40"/>'
        for name in panda().joint_names
    )
    text = path.read_text().replace("</mujoco>", f"<actuator>{servos}</actuator></mujoco>")
    path.write_text(text)
    return path, Body.load(path)


def played(robot, late=0.0, offset=0.0, lag=0.0, at=3, seconds=8.0):
    """MuJoCo's log of it, one joint with a delay or a lag, s, of its target, or an offset, rad, of its encoder."""
    path, body = robot
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.timestep, data, rng = 2.5e-4, mujoco.MjData(model), np.random.default_rng(0)
    time = np.arange(0, seconds, 0.01)
    w, phase = 2 * np.pi * rng.uniform(0.2, 0.8, (3, 7)), rng.uniform(0, 6, (3, 7))
    middle = np.array([0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.8])
    told = middle + (0.12 * (np.sin(time[:, None, None] * w + phase) - np.sin(phase))).sum(1)
    data.qpos[:], seen, acts = middle, [], told[0].copy()
    for row in range(len(time)):
        seen.append(data.qpos.copy())
        for step in range(40):
            target = told[row].copy()
            target[at] = told[max(int(np.floor(row + (step + 0.5) / 40 - late * 100)), 0), at] - offset
            share = -np.expm1(-2.5e-4 / lag) if lag else 1.0
            acts[:], acts[at] = target, acts[at] + share * (target[at] - acts[at])
            data.ctrl[:] = acts
            mujoco.mj_step(model, data)
    angles = np.array(seen) + 2e-4 * rng.standard_normal(told.shape)
    angles[:, at] += offset
    torques = np.stack([servo_torque(p.servo, c) for p, c in zip(body.joint_parts, told.T, strict=True)], -1)
    nothing = np.empty((len(time), 0, 3))
    return Recording(time, nothing, (), angles=angles, torques=torques, joint_names=body.joint_names)


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "effect", "value"),
    [
        ({}, None, 0.0),
        pytest.param({"late": 0.015}, "actuator_delay", 0.015, marks=pytest.mark.slow),
        ({"lag": 0.015}, "actuator_lag", 0.015),
        pytest.param({"offset": 0.08}, "encoder_offset", 0.08, marks=pytest.mark.slow),
    ],
)
def test_mujocos_robot_of_seven_joints_is_told_what_is_odd(robot, change, effect, value):
    """A delay and a lag of as much are named together."""
    result = regress(played(robot, **change), robot[1])
    sure = {(s.effect, place): s.rivals.get(place, ()) for s in result.stated for place in s.sure}
    if effect is None:
        assert sure == {}
        return
    joint = robot[1].joint_names[3]
    ((named, place),) = sure
    assert place == joint
    assert effect in (named, *sure[named, place])
    (number,) = [e for e in result.numbers if (e.effect, e.place) == (named, place)]
    assert number.value == pytest.approx(value, rel=0.05)
