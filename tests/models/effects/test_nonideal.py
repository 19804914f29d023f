"""Non-ideal variants: dry friction and stops against fine integration, and against MuJoCo with its default options."""

import numpy as np
import pytest
import torch
from rod import F64, INERTIA, driven, rod, rolled, torque_of
from scipy.integrate import solve_ivp
from variants import nonideal

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body
from invdyn.models.effects import (
    EFFECTS,
    CoulombFriction,
    JointLimit,
    JointStiffness,
    LoadFriction,
    TorqueRipple,
    ViscousFriction,
)

RATE = 1 / (0.95 * 0.02)  # 1/s, of MuJoCo's default: time constant 20 ms, impedance .9 to .95, damping ratio 1
RUBBING = {"settling": 1 / RATE / 2 / 0.9, "creep": 0.1 / RATE / 2 / 0.9}
STOP = {"stiffness": 0.95 * INERTIA * RATE**2, "damping": 2 * INERTIA * RATE, "softness": 0.05 / 0.95}


def in_mujoco(joint, q, qd, rows=100, step=0.01, gravity=-9.81):
    """Angles (rows,) of the rod under gravity along y, in steps of 0.1 ms."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 {gravity} 0" timestep="1e-4"/><worldbody><body>'
        f'<joint type="hinge" axis="0 0 1" {joint}/>'
        '<inertial pos="0.15 0 0" mass="1.5" diaginertia="0.01125 0.01125 0.01125"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = q, qd
    angles = []
    for _ in range(rows):
        angles.append(data.qpos[0])
        for _ in range(round(step / 1e-4)):
            mujoco.mj_step(model, data)
    return np.array(angles)


@pytest.mark.parametrize("share", [1.0, 0.3, 0.0])
def test_a_share_of_the_coriolis_torque_loads_a_gear(share, arm, states, having):
    """All of it in the ideal form; with none of it gravity and the motor alone."""
    ideal = arm(2)
    effect = nonideal(LoadFriction("joint0"))
    model = having(ideal, effect, coefficient=0.2, settling=0.0, creep=0.0, coriolis_share=share)
    _, q, qd = ideal.split(states(ideal, 50))
    qd = qd + qd.sign()  # fast enough not to stop within the sub-step
    torque, body = torch.randn(50, 2, dtype=F64), ideal.body_parameters()
    now = model.mechanics.now(driven(model, torque), q, qd, 0.0)
    load = torque + ideal.dynamics.gravity_load(q, body) + share * ideal.dynamics.coriolis(q, qd, body)
    friction, _, _ = model.effects.friction(model.parameters, now, torque, None)
    expected = -0.2 * load[:, 0].abs() * qd[:, 0].sign()
    torch.testing.assert_close(friction[:, 0], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.quick("*-0.0137")
@pytest.mark.parametrize("step", [0.0137, 0.03, 0.1])
@pytest.mark.parametrize(("settling", "creep"), [(0.0, 0.0), (0.002, 0.0), (0.011, 0.001), (0.06, 0.015)])
def test_a_rod_settles_and_turns_around_within_a_step(settling, creep, step, having):
    """Friction changes sign a settling time before the motion does: exact at a constant torque, whatever the step."""
    level, push = 0.3, -1.1
    command = torch.full((int(0.8 / step) + 2, 1), push, dtype=F64)
    model = rod(rows=len(command), step=step, command=command)
    values = {"torque": level, "settling": settling, "creep": creep}
    q, qd = rolled(having(model, nonideal(CoulombFriction("hinge")), **values), [0.0], [6.0])
    if settling == 0.0:  # at once, as the ideal law has it
        exact = rolled(having(model, CoulombFriction("hinge"), torque=level), [0.0], [6.0])
    else:
        time = step * np.arange(len(command))

        def rate(_, x):
            held = push + (x[1] * INERTIA - push * creep) / settling
            return [x[1], (push - np.clip(held, -level, level)) / INERTIA]

        fine = {"rtol": 1e-10, "atol": 1e-12, "max_step": 1e-3, "method": "LSODA"}
        exact = solve_ivp(rate, (0, time[-1]), [0.0, 6.0], t_eval=time, **fine).y[..., None]
    near = 2e-5 if settling == 0.0 else 1e-9  # rad/s: a microsecond, the shortest time, at 20 rad/s²
    assert qd == pytest.approx(exact[1], abs=near)
    assert q == pytest.approx(exact[0], abs=near)


@pytest.mark.parametrize("creep", [0.0, 0.005])
def test_a_rod_that_friction_holds_creeps(creep, having):
    """Pushed by less than the friction its speed falls to a ρ, with the time constant T."""
    time, command = 0.01 * np.arange(30), torch.full((30, 1), 0.1, dtype=F64)
    model = rod(rows=30, step=0.01, command=command)
    values = {"torque": 2.0, "settling": 0.02, "creep": creep}
    _, qd = rolled(having(model, nonideal(CoulombFriction("hinge")), **values), [0.0], [0.5])
    slow = 0.1 / INERTIA * creep
    assert qd[:, 0] == pytest.approx(slow + (0.5 - slow) * np.exp(-time / 0.02), abs=1e-12)


@pytest.mark.long
def test_two_joints_settle_as_shorter_sub_steps_have_it(arm):
    ends, kinds = {}, [nonideal(CoulombFriction(f"joint{k}")) for k in range(2)]
    command = np.tile([0.5, -0.2], (41, 1))
    model = arm(2, rows=41, command=command).with_effects(*kinds)
    values = {"torque": 0.4, "settling": 0.01, "creep": 0.001}
    model = model.replace(
        **{f"effect.{e.key}.{n}": torch.tensor([v], dtype=F64) for e in kinds for n, v in values.items()}
    )
    for steps in (2, 8, 64):
        model = model.in_substeps(model.substeps, steps)
        ends[steps] = np.stack(rolled(model, [-1.4, 0.1], [1.0, -1.0]))
    coarse, fine = (np.abs(ends[steps] - ends[64]).max() for steps in (2, 8))
    assert coarse < 0.003
    assert fine < coarse / 3


@pytest.mark.quick("0.8")
@pytest.mark.parametrize("level", [0.3, 0.8])
def test_mujocos_default_friction_is_the_regularised_one(level, having):
    """A rod swings, comes to rest and creeps: thirty times as near to it as under the ideal law."""
    theirs = in_mujoco(f'frictionloss="{level}"', 0.5, 0.0, rows=180)
    ideal = rod(rows=180, step=0.01, gravity=(0.0, -9.81))
    mine, _ = rolled(having(ideal, CoulombFriction("hinge"), torque=level), [0.5], [0.0])
    soft, _ = rolled(having(ideal, nonideal(CoulombFriction("hinge")), torque=level, **RUBBING), [0.5], [0.0])
    far, near = (np.abs(q[:, 0] - theirs).max() for q in (mine, soft))
    assert near < 1e-3
    assert near < far / 30


@pytest.mark.long
def test_mujocos_default_stop_is_the_regularised_one(having):
    """A rod falls onto it: within 1.5 mrad, which no spring and damper come to."""
    theirs = in_mujoco('range="-9 0.1" limited="true"', -0.6, 2.0, gravity=9.81)
    base = rod(rows=100, step=0.01, gravity=(0.0, 9.81))
    q, _ = rolled(having(base, nonideal(JointLimit("hinge")), angle=0.1, **STOP), [-0.6], [2.0])
    assert theirs.max() > 0.15
    assert q[:, 0] == pytest.approx(theirs, abs=1.5e-3)
    for stiffness in (50.0, 100.0, 200.0, 400.0, 1600.0):
        for damping in (1.0, 3.0, 5.0, 10.0):
            ideal = having(base, JointLimit("hinge"), angle=0.1, stiffness=stiffness, damping=damping)
            q, _ = rolled(ideal, [-0.6], [2.0])
            assert np.abs(q[:, 0] - theirs).max() > 0.005


@pytest.mark.quick("upper-1.0")
@pytest.mark.parametrize(("side", "sign"), [("upper", 1.0), ("lower", -1.0)])
def test_a_steady_torque_presses_a_regularised_stop_in_by_its_softness(side, sign, having):
    """e = R τ / k; that from which its search begins is as deep as the ideal one, τ / k."""
    command = torch.full((241, 1), sign * 2.0, dtype=F64)
    model, stop = rod(rows=241, command=command), JointLimit("hinge", side)
    given = {"angle": sign * 0.5, "stiffness": 40.0, "damping": 2.0}
    for effect, values, depth in (
        (nonideal(stop), {**given, "softness": 0.1}, 0.1 * 2.0 / 40.0),
        (nonideal(stop), CATALOGUE.of(stop).start(nonideal(stop), given), 2.0 / 40.0),
        (stop, given, 2.0 / 40.0),
    ):
        q, _ = rolled(having(model, effect, **values), [sign * 0.5], [0.0])
        assert q[-1, 0] == pytest.approx(sign * (0.5 + depth), abs=1e-5)


def test_a_regularised_stop_yields_to_any_load(having):
    """A spring as a command does."""
    effects = (nonideal(JointLimit("hinge")), JointStiffness("hinge"))
    model = rod(rows=301, command=torch.zeros(301, 1, dtype=F64)).with_effects(*effects)
    given = {effects[0].key: {"angle": 0.5, **STOP}, effects[1].key: {"stiffness": 4.0, "torque": 4.0}}
    named = {f"effect.{key}.{name}": value for key, values in given.items() for name, value in values.items()}
    model = model.replace(**{key: torch.tensor([value], dtype=F64) for key, value in named.items()})
    q, _ = rolled(model, [0.0], [0.0])
    theirs = in_mujoco('range="-9 0.5" limited="true" stiffness="4" springref="1"', 0.0, 0.0, rows=151, gravity=0)
    assert q[-1, 0] - 0.5 == pytest.approx(theirs[-1] - 0.5, abs=3e-4)
    assert 0.0005 < theirs[-1] - 0.5 < 0.002


@pytest.mark.parametrize("gravity", [(0.0, -9.81), (0.0, 0.0)])
@pytest.mark.parametrize("length", [0.1, 0.3, 1.0])
def test_mujocos_default_stop_is_plausible_at_every_size(length, gravity):
    body = planar_body("rod", [Link("link", "hinge", "tip", length=length, mass=1.5)], gravity=gravity)
    model = ArmModel(body, 0.01 * np.arange(9), Observation(Keypoints([0])), command=np.full((9, 1), 0.3 * length))
    (inertia,) = model.scale.inertia
    priors = {p.name: p.prior for p in nonideal(JointLimit("hinge")).bound(body).parameters(model.scale)}
    for name, value in STOP.items():
        value *= inertia / INERTIA if name != "softness" else 1.0
        assert value < DEFAULT.residual.max_prior_sds / 2 * priors[name].scale


def test_a_ripple_that_is_no_pure_sine(having):
    """Its second harmonic, by the amplitude and phase that are reported."""
    values = {"sine": 0.3, "cosine": -0.2, "periods": 7.0, "second_sine": 0.05, "second_cosine": 0.12}
    effect, ideal = nonideal(TorqueRipple("hinge")), rod()
    told = CATALOGUE.of(effect).reported(effect, {name: torch.tensor([value]) for name, value in values.items()})
    A, phase, N, second, second_phase = (value.item() for value, _ in told.values())
    q = torch.linspace(-2.0, 2.0, 50, dtype=F64)
    x = torch.stack([torch.zeros_like(q), q, torch.zeros_like(q)], -1)
    found = torque_of(having(ideal, effect, **values), ideal, x)[:, 0]
    expected = A * torch.sin(N * q + phase) + second * torch.sin(2 * N * q + second_phase)
    torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6)
    given = {name: values[name] for name in ("sine", "cosine", "periods")}
    start = CATALOGUE.of(effect).start(effect, given)
    same = having(ideal, effect, **start), having(ideal, TorqueRipple("hinge"), **given)
    torch.testing.assert_close(*(torque_of(each, ideal, x) for each in same))


@pytest.mark.parametrize("name", EFFECTS)
def test_a_variant_is_the_same_effect_with_more_parameters(name, arm):
    model = arm(2)
    every = EFFECTS[name].everywhere(model.body, model.body.keypoint_names)
    ideal = next(effect for effect in reversed(every) if effect.form is None).bound(model.body)
    soft = nonideal(ideal)
    having = ["coulomb_friction", "stribeck_friction", "load_friction", "joint_limit", "link_flexibility"]
    having += ["torque_ripple", "soft_tissue", "camera_scale", "camera_roll", "camera_yaw", "lens_distortion"]
    assert (soft is not None) == (name in having)
    if soft is None:
        return
    assert (soft.key, soft.place, soft.variant) == (ideal.key, ideal.place, ideal.variant + 1)
    assert (nonideal(soft) is not None) == name.endswith(("coulomb_friction", "stribeck_friction", "load_friction"))
    mine, more = (e.parameters(model.scale) for e in (ideal, soft))
    assert [p.name for p in more[: len(mine)]] == [p.name for p in mine]
    start = CATALOGUE[name].start(soft, {p.name: 1.0 for p in mine})
    assert list(start) == [p.name for p in more]


def test_one_joint_settles_with_the_longer_of_two_times(arm, states):
    """Two soft frictions at one joint are one, of the sum of their levels."""
    kinds = [nonideal(EFFECTS[name]("joint1")) for name in ("coulomb_friction", "stribeck_friction")]
    model = arm(2).with_effects(ViscousFriction("joint0"), *kinds)
    one = arm(2).with_effects(kinds[0])
    given = {"coulomb": 0.2, "static": 0.2, "velocity": 1.0}
    values = {f"{kinds[1].key}.{name}": value for name, value in given.items()}
    values |= {f"{kinds[0].key}.torque": 0.1, f"{kinds[0].key}.settling": 0.02, f"{kinds[1].key}.settling": 0.005}
    values |= {f"{kinds[0].key}.creep": 0.002, f"{kinds[1].key}.creep": 0.001}
    model = model.replace(**{f"effect.{key}": torch.tensor([v], dtype=F64) for key, v in values.items()})
    together = {"torque": 0.1 + 0.2, "settling": 0.02, "creep": 0.002}
    together = {f"effect.{kinds[0].key}.{name}": value for name, value in together.items()}
    one = one.replace(**{key: torch.tensor([v], dtype=F64) for key, v in together.items()})
    x, rows = states(one, 12), torch.arange(1, 12)
    x[..., -1] *= 0.05
    one = one.in_substeps(one.substeps, model.abrupt)
    torch.testing.assert_close(model.transition_mean(x[:-1], rows), one.transition_mean(x[:-1], rows))
