"""Friction through bristles: against fine integration and MuJoCo's own, and the ideal law as they get stiff."""

import numpy as np
import pytest
import torch
from rod import F64, INERTIA, rod, rolled
from scipy.integrate import solve_ivp
from variants import nonideal

from invdyn.models.effects import CoulombFriction, LinkFlexibility, LoadFriction, StribeckFriction, ViscousFriction
from invdyn.models.effects.regularised_friction import BristleFriction

STRIBECK = {"coulomb": 0.3, "static": 0.6, "velocity": 1.0}
ROWS, STEP = 151, 0.01


def pushed():
    """A command (T, 1) that turns the rod around, and holds it in between."""
    time = STEP * np.arange(ROWS)
    return torch.as_tensor(1.2 * np.sin(2 * np.pi * 0.8 * time))[:, None]


@pytest.mark.quick("100.0")
@pytest.mark.parametrize("stiffness", [100.0, 400.0])
def test_a_rod_turns_around_on_its_bristles(stiffness, having):
    model = rod(rows=ROWS, step=STEP, command=pushed())
    values = {**STRIBECK, "bristle_stiffness": stiffness, "bristle_damping": 1.0}
    q, qd = rolled(having(model, BristleFriction(StribeckFriction("hinge")), **values), [0.0], [0.0])

    def rate(_, x, push):
        bent = x[1] - stiffness * abs(x[1]) / (0.3 + 0.3 * np.exp(-(x[1] ** 2))) * x[2]
        return [x[1], (push - stiffness * x[2] - bent) / INERTIA, bent]

    exact = [np.zeros(3)]
    for push in pushed()[:-1, 0].tolist():
        fine = solve_ivp(rate, (0, STEP), exact[-1], args=(push,), method="LSODA", rtol=1e-9, atol=1e-11)
        exact.append(fine.y[:, -1])
    exact = np.array(exact)
    ideal, _ = rolled(having(model, StribeckFriction("hinge"), **STRIBECK), [0.0], [0.0])
    off = np.abs(ideal[:, 0] - exact[:, 0]).max()
    assert off > 0.05
    assert q[:, 0] == pytest.approx(exact[:, 0], abs=0.03 * off)
    assert qd[:, 0] == pytest.approx(exact[:, 1], abs=5e-3 * np.abs(exact[:, 1]).max())


@pytest.mark.long
def test_it_is_lugre_in_mujoco(having):
    """A motor without electricity that rubs as ``lugre`` says."""
    mujoco = pytest.importorskip("mujoco")
    xml = (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="1e-4"/><worldbody><body>'
        '<joint name="hinge" type="hinge" axis="0 0 1"/>'
        '<inertial pos="0.15 0 0" mass="1.5" diaginertia="0.01125 0.01125 0.01125"/></body></worldbody><actuator>'
        '<motor joint="hinge"/><dcmotor joint="hinge" input="none" motorconst="0" resistance="1" '
        'lugre="200 1 0.3 0.6 1"/></actuator></mujoco>'
    )
    try:
        model = mujoco.MjModel.from_xml_string(xml)
    except ValueError as error:
        pytest.skip(f"this MuJoCo has no lugre: {error}")
    data, angles = mujoco.MjData(model), []
    for push in pushed()[:, 0].tolist():
        angles.append(data.qpos[0])
        data.ctrl[0] = push
        for _ in range(round(STEP / 1e-4)):
            mujoco.mj_step(model, data)
    values = {**STRIBECK, "bristle_stiffness": 200.0, "bristle_damping": 1.0}
    rubbed = having(rod(rows=ROWS, step=STEP, command=pushed()), BristleFriction(StribeckFriction("hinge")), **values)
    q, _ = rolled(rubbed, [0.0], [0.0])
    ideal, _ = rolled(
        having(rod(rows=ROWS, step=STEP, command=pushed()), StribeckFriction("hinge"), **STRIBECK), [0.0], [0.0]
    )
    angles = np.array(angles)
    assert np.abs(q[:, 0] - angles).max() < 0.1 * np.abs(ideal[:, 0] - angles).max()


def test_stiff_bristles_are_the_ideal_law(having):
    model = rod(rows=ROWS, step=1e-3, command=pushed())
    ideal, _ = rolled(having(model, CoulombFriction("hinge"), torque=0.4), [0.0], [3.0])
    errors = []
    for stiffness in (400.0, 4000.0):
        values = {"torque": 0.4, "bristle_stiffness": stiffness, "bristle_damping": 0.1 * stiffness**0.5}
        errors.append(
            np.abs(
                rolled(having(model, BristleFriction(CoulombFriction("hinge")), **values), [0.0], [3.0])[0] - ideal
            ).max()
        )
    assert errors[1] < 0.2 * errors[0] < 0.2 * 0.02


def test_a_joint_that_slides_bends_them_all_the_way(having):
    model = having(
        rod(), BristleFriction(LoadFriction("hinge")), coefficient=0.2, bristle_stiffness=100.0, bristle_damping=0.5
    )
    bristles = model.effects.bristles
    p = {"bristle_stiffness": torch.tensor([100.0], dtype=F64), "bristle_damping": torch.tensor([0.5], dtype=F64)}
    level, step = torch.tensor([0.3], dtype=F64), torch.tensor([0.002], dtype=F64)
    for speed in (0.5, 5.0, 500.0, -500.0):
        s, v = torch.zeros(1, dtype=F64), torch.tensor([speed], dtype=F64)
        for _ in range(100):
            friction, rate = bristles.bending(p, s, v, level, step)
            s = s + step * rate
        assert friction.item() == pytest.approx(-0.3 * np.sign(speed), rel=1e-3)
    friction, rate = bristles.bending(p, s, v, torch.zeros(1, dtype=F64), step)
    assert (friction.item(), rate.item()) == (0.0, 0.0)


def test_acceleration_knows_how_far_they_are_bent(arm, having, states):
    """As far as the joint is slowed down in a moment."""
    values = {"torque": 1.0, "bristle_stiffness": 200.0, "bristle_damping": 0.5}
    model = having(arm(2, step=1e-5), BristleFriction(CoulombFriction("joint1")), **values)
    x = states(model, 6)
    x[:, 2] = torch.linspace(-0.004, 0.004, 6, dtype=F64)
    body = model.body_parameters()
    ideal = arm(2, step=1e-5)
    plain = torch.cat([x[:, :2], x[:, 3:]], -1)
    rows = torch.full((6,), 5)
    change = model.acceleration(x, rows, body) - ideal.acceleration(plain, rows, body)
    after = model.transition_mean(x, rows)[:, -2:] - ideal.transition_mean(plain, rows)[:, -2:]
    torch.testing.assert_close(change, after / 1e-5, rtol=1e-2, atol=1e-2)


def test_it_stands_under_the_frictions_own_name(arm):
    soft = nonideal(CoulombFriction("joint1"))
    bristles = nonideal(soft)
    assert isinstance(bristles, BristleFriction)
    assert (bristles.key, nonideal(bristles), bristles.variant) == (soft.key, None, 2)
    model = arm(2)
    names = [p.name for p in bristles.bound(model.body).parameters(model.scale)]
    assert names == ["torque", "bristle_stiffness", "bristle_damping"]
    beside = model.with_effects(bristles, CoulombFriction("joint0"), ViscousFriction("joint0"))
    assert beside.state_dim == model.state_dim + 1
    with pytest.raises(ValueError, match="at most one effect whose hidden states move the arm"):
        model.with_effects(bristles, LinkFlexibility("link1"))
