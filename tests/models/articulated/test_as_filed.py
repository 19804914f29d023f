"""A file's damping, rotors, springs, friction, geared motors and servos, played as MuJoCo plays them."""

import dataclasses

import mujoco
import numpy as np
import pytest
import torch

from invdyn.models import ArmModel, Body, Link, planar_body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.models.effects.friction import LoadFriction, ViscousFriction
from invdyn.models.effects.motors import ActuatorGain

TEXT = """<mujoco><compiler angle="radian"/><option timestep="0.0002" gravity="0 0 -9.81" integrator="RK4"/>
<worldbody><body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 {way} 0" {shoulder}/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1.2" contype="0" conaffinity="0"/>
<body name="fore" pos="0 0 -0.3"><joint name="elbow" axis="0 {way} 0" {elbow}/>
<geom type="capsule" fromto="0 0 0 0.2 0 -0.15" size="0.015" mass="0.8" contype="0" conaffinity="0"/>
<site name="tip" pos="0.2 0 -0.15"/></body></body></worldbody><actuator>{motors}</actuator></mujoco>"""
MOTORS = '<motor name="s" joint="shoulder"/><motor name="e" joint="elbow" gear="10"/>'
STEP, ROWS = 0.01, 80
CASES = {
    "damping and a rotor": ('damping="0.3" armature="0.02"', 'damping="0.05"', MOTORS),
    "springs": ('stiffness="2" springref="0.4"', 'stiffness="1" springref="-0.3"', MOTORS),
    "a limit of a geared motor": ("", 'damping="0.1"', MOTORS.replace('gear="10"', 'gear="10" forcerange="-.02 .03"')),
    "a limit of the joint": ('actuatorfrcrange="-1 1.5" damping=".2"', 'damping="0.1"', MOTORS),
    "a position servo": (
        "",
        'damping="0.1"',
        '<position joint="shoulder" kp="10" kv="1" gear="2" forcerange="-2 3"/><motor joint="elbow" gear="10"/>',
    ),
    "a velocity servo": ("", 'damping="0.1"', '<velocity joint="shoulder" kv="2"/><motor joint="elbow" gear="10"/>'),
}


def in_mujoco(text: str, loaded: float = 0.0, rows: int = ROWS) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (T, 2) and controls (T, 2) that are held between rows; ``loaded`` friction k at the shoulder."""
    model = mujoco.MjModel.from_xml_string(text)
    data, per = mujoco.MjData(model), round(STEP / model.opt.timestep)
    time = np.arange(rows) * STEP
    control = np.stack([2.0 * np.sin(3 * time + 0.3), 0.05 * np.sin(5 * time)], -1)
    angles = np.zeros((rows, 2))
    for row in range(rows):
        angles[row], data.ctrl[:] = data.qpos, control[row]
        for _ in range(per):
            if loaded:
                model.dof_frictionloss[0] = max(loaded * abs(data.qfrc_actuator[0] + data.qfrc_bias[0]), 1e-9)
            mujoco.mj_step(model, data)
    return angles, control


def off_by(model: ArmModel, parameter: str, values: tuple[float, ...], theta: np.ndarray) -> np.ndarray:
    """Largest errors, rad, of the angles that the model plays from ``theta`` (T, 2)'s first, for each of the values."""
    model = model.replace(**{parameter: torch.tensor(values, dtype=torch.float64).unsqueeze(-1)})
    states = torch.zeros(ROWS, len(values), model.state_dim, dtype=torch.float64)
    states[0, :, -4:-2] = torch.as_tensor(theta[0])
    for row in range(1, ROWS):
        states[row] = model.transition_mean(states[row - 1], row)
    return np.abs(model.split(states)[1].numpy() - theta[:, None]).max((0, 2))


@pytest.mark.quick("*[!-]-1")
@pytest.mark.parametrize(("case", "way"), [*((case, 1) for case in CASES), ("springs", -1), ("a position servo", -1)])
@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_the_model_moves_as_mujoco_does(tmp_path, case, way):
    shoulder, elbow, motors = CASES[case]
    text = TEXT.format(way=way, shoulder=shoulder, elbow=elbow, motors=motors)
    (tmp_path / "robot.xml").write_text(text)
    body = Body.load(tmp_path / "robot.xml")
    q, control = in_mujoco(text)
    parts = body.joint_parts
    sign, zero = np.array([p.sign for p in parts]), np.array([p.zero for p in parts])
    servo = parts[0].servo
    first = sign[0] * control[:, 0]
    if servo is not None:
        gear = 2.0 if servo.kind == "position" else 1.0
        told = control[:, 0] / gear * sign[0] + (zero[0] if servo.kind == "position" else 0.0)
        first = servo_torque(servo, told)
    command = np.stack([first, sign[1] * 10 * control[:, 1]], -1)
    model = ArmModel(body, np.arange(ROWS) * STEP, command=command, substeps=5)
    theta = zero + sign * q
    state = torch.zeros(model.state_dim, dtype=torch.float64)
    state[-4:-2] = torch.as_tensor(theta[0])
    played = [state]
    for row in range(1, ROWS):
        played.append(model.transition_mean(played[-1], row))
    angles = model.split(torch.stack(played))[1].numpy()
    assert np.ptp(theta, axis=0).min() > 0.2  # it moves
    # a limit is reached within a row, which the model follows by a line over the row
    np.testing.assert_allclose(angles, theta, atol=2e-3 if "limit" in case or "servo" in case else 1e-6)


def test_friction_holds_what_it_can():
    link = {"length": 1.0, "mass": 1.0}
    free, held = (
        Body.from_tables({"links": [{"name": "a", "joint": "j", "tip": "t", **link, "friction": f}]}, "arm")
        for f in (0.0, 6.0)
    )
    state = torch.zeros(3, dtype=torch.float64)
    moved, stays = (ArmModel(b, np.arange(5) * 0.01).transition_mean(state, 1) for b in (free, held))
    assert abs(float(moved[2])) > 0.01
    assert abs(float(stays[2])) < 1e-9  # gravity's 4.9 N·m are less than 6


def test_an_effect_is_a_change_of_what_the_file_has():
    """It may take away as much as there is, and no more; both together are one damping."""
    table = {"name": "a", "joint": "j", "tip": "t", "length": 1.0, "mass": 1.0}
    some, more = (Body.from_tables({"links": [{**table, "damping": b}]}, "arm") for b in (0.3, 0.5))
    time = np.arange(20) * 0.01
    changed = ArmModel(some, time).with_effects(ViscousFriction("j"))
    changed = changed.replace(**{"effect.viscous_friction.j.damping": torch.tensor([0.2], dtype=torch.float64)})
    state = torch.tensor([0.5, -1.0, 2.0], dtype=torch.float64)
    torch.testing.assert_close(changed.transition_mean(state, 1), ArmModel(more, time).transition_mean(state, 1))
    (parameter,) = changed.effects.effects[0].parameters(changed.scale)
    assert parameter.least == -0.3
    assert parameter.prior.support.check(torch.tensor(-0.1))


def test_parts_survive_a_file(tmp_path):
    motor = Motor("position", gain=40.0, stiffness=40.0, damping=2.0, bias=1.5, low=-5.0, high=6.0)
    parts = JointParts(0.1, 0.2, 0.01, 2.0, -0.3, motor, -1.0, 0.5)
    body = Body.from_tables(
        {"links": [{"name": "a", "joint": "j", "tip": "t", "length": 1.0, "mass": 1.0, "damping": 0.1}]}, "arm"
    )
    body = dataclasses.replace(body, links=[dataclasses.replace(body.links[0], parts=parts)])
    body.to_toml(tmp_path / "arm.toml")
    assert Body.load(tmp_path / "arm.toml") == body


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_friction_under_load_counts_what_a_servo_gives(tmp_path):
    """Of MuJoCo's actuator and bias torques; of the servo's command alone it would be ten times as large."""
    servo = '<position joint="shoulder" kp="60" kv="2"/><motor joint="elbow" gear="10"/>'
    text = TEXT.format(way=1, shoulder='frictionloss="1e-9"', elbow='damping="0.1"', motors=servo)
    (tmp_path / "robot.xml").write_text(text.replace(' frictionloss="1e-9"', ""))
    body = Body.load(tmp_path / "robot.xml")
    q, control = in_mujoco(text, loaded=0.2)
    first, second = body.joint_parts
    theta = np.array([first.zero, second.zero]) + np.array([first.sign, second.sign]) * q
    told = servo_torque(first.servo, control[:, 0] * first.sign + first.zero)
    command = np.stack([told, second.sign * 10 * control[:, 1]], -1)
    friction = LoadFriction("shoulder").bound(body)
    model = ArmModel(body, np.arange(ROWS) * STEP, command=command, substeps=10).with_effects(friction)
    without, with_friction = off_by(model, f"effect.{friction.key}.coefficient", (0.0, 0.2), theta)
    # MuJoCo's friction is a regularised form of the ideal law: see the top of `regularised_friction`
    assert with_friction < 0.02 < 0.1 < without, (without, with_friction)


def test_a_servos_limit_cuts_what_was_told_alone():
    """Told 5 N·m of which it gives 1, beside 2 N·m that nobody told it."""
    servo = JointParts(motor=Motor("position", gain=60.0, stiffness=60.0, low=-1.0, high=1.0))
    body = planar_body("arm", [Link("rod", "joint", "tip", 1.0, 1.0, parts=servo)], gravity=(0.0, 0.0))
    model = ArmModel(body, np.arange(3) * 1e-3, command=np.full((3, 1), 5.0))
    after = model.transition_mean(torch.tensor([2.0, 0.0, 0.0], dtype=torch.float64), 1)
    assert float(after[-1]) == pytest.approx((1 + 2) * 3 * 1e-3, rel=0.01)  # of an inertia of a third


def test_a_servo_without_a_command_has_no_part_in_the_motion():
    """Where torques are unknown they are the whole; a stiff servo would hold its joint at zero against them."""
    servo = JointParts(damping=0.3, motor=Motor("position", gain=4500.0, stiffness=4500.0, damping=450.0))
    rods = [Link("rod", "joint", "tip", 1.0, 1.0, parts=parts) for parts in (servo, JointParts(damping=0.3))]
    held, free = (ArmModel(planar_body("arm", [rod], gravity=(0.0, 0.0)), np.arange(3) * 1e-3) for rod in rods)
    state = torch.tensor([2.0, 0.5, 0.1], dtype=torch.float64)
    assert torch.equal(held.transition_mean(state, 1), free.transition_mean(state, 1))
    command = np.full((3, 1), 5.0)
    later, told = held.commanded(command), ArmModel(held.body, np.arange(3) * 1e-3, command=command)
    assert torch.equal(later.transition_mean(state, 1), told.transition_mean(state, 1))
    assert not torch.equal(told.transition_mean(state, 1), free.commanded(command).transition_mean(state, 1))


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_where_a_servo_takes_the_arm_is_what_its_rows_say(dtype):
    """Two rows ahead it has answered several times; a tenth of a row back is still third order."""
    servo = JointParts(motor=Motor("position", gain=60.0, stiffness=60.0, damping=2.0))
    upper, fore = Link("upper", "shoulder", "elbow", 0.3, 1.2, parts=servo), Link("fore", "elbow", "wrist", 0.25, 0.8)
    body = planar_body("arm", [upper, fore], gravity=(0.0, -9.81))
    command = torch.randn(8, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    model = ArmModel(body, np.arange(8) * 0.02, command=command.numpy(), substeps=10).to(dtype)
    state = torch.zeros(model.state_dim, dtype=dtype)
    state[-4:] = torch.tensor([-0.5, 0.4, 1.0, -0.5], dtype=dtype)
    states = [state]
    for row in (4, 5):
        states.append(model.transition_mean(states[-1], row))
    view = model.observation_model.view(state, 3)
    _, q, qd = model.split(torch.stack(states))
    for rows in (0, 1, 2):
        later = view.angles_after(torch.tensor([0.02 * rows], dtype=dtype))
        # a straight line stands for a command that jumps within a stretch
        np.testing.assert_allclose(later, q[rows], atol=2e-4)
    third_order = model.observation_model.to_third_order(
        state, 3, model.body_parameters(), torch.tensor([0.04], dtype=dtype)
    )
    assert (third_order - q[2]).abs().max() > 0.02
    ago = torch.tensor([-0.002], dtype=dtype)
    back = model.observation_model.to_third_order(states[1], 4, model.body_parameters(), ago)
    assert torch.equal(model.observation_model.view(states[1], 4).angles_after(ago), back)
    np.testing.assert_allclose(back, q[1] - 0.002 * qd[1], atol=2e-3)  # ½ τ² θ̈ of 700 rad/s²


@pytest.mark.quick("implicitfast*")
@pytest.mark.parametrize(
    ("integrator", "flag", "late"),
    [
        ("Euler", "", (-0.2, -0.4)),
        ("Euler", '<flag eulerdamp="disable"/>', (-0.8, -0.6)),
        ("implicit", "", (0.8, 0.6)),
        ("implicitfast", "", (0.8, 0.6)),
        ("RK4", "", (0.0, 0.0)),
    ],
)
@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_in_the_engines_own_steps_the_model_moves_as_the_engine(tmp_path, integrator, flag, late):
    """What the equations themselves are off by is of first order in steps of 2 ms, what is left of second."""
    servos = '<position joint="shoulder" kp="40" kv="0.5"/><position joint="elbow" kp="40" kv="0.5"/>'
    text = TEXT.format(way=1, shoulder='damping="0.3" armature="0.02"', elbow='damping="0.1"', motors=servos)
    option = f'timestep="0.002" integrator="{integrator}" gravity="0 0 -9.81">{flag}</option>'
    text = text.replace('timestep="0.0002" gravity="0 0 -9.81" integrator="RK4"/>', option)
    (tmp_path / "robot.xml").write_text(text)
    body = Body.load(tmp_path / "robot.xml")
    parts = body.joint_parts
    assert [each.late for each in parts] == pytest.approx(late)
    assert {each.step for each in parts} == {0.0 if integrator == "RK4" else 0.002}
    rows = 120  # by then what the start brought has been damped away
    q, control = in_mujoco(text, rows=rows)
    theta = np.stack([each.zero + each.sign * q[:, k] for k, each in enumerate(parts)], -1)
    told = [servo_torque(each.servo, each.zero + each.sign * control[:, k]) for k, each in enumerate(parts)]
    model = ArmModel(body, np.arange(rows) * STEP, command=np.stack(told, -1))
    off = {}
    for stepped, played in (False, model.in_substeps(5)), (True, model.in_substeps(5).in_engine_steps()):
        states = torch.zeros(rows, played.state_dim, dtype=torch.float64)
        states[0, -4:-2] = torch.as_tensor(theta[0])
        for row in range(1, rows):
            states[row] = played.transition_mean(states[row - 1], row)
        off[stepped] = np.abs(played.split(states)[1].numpy() - theta)[rows // 2 :].max()
    assert off[True] < (1.0 if integrator == "RK4" else 1 / 3) * off[False] + 1e-12, off


SERVOS = {
    "position": ('<position joint="shoulder" kp="{gain}" kv="1" gear="2" forcerange="-2 3"/>', 10.0),
    "velocity": ('<velocity joint="shoulder" kv="{gain}" forcerange="-1.5 1.5"/>', 2.0),
}


@pytest.mark.quick("position-1")
@pytest.mark.parametrize(("kind", "way"), [("position", 1), ("velocity", -1)])
@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_a_servos_gain_is_that_of_its_mujoco_actuator(tmp_path, kind, way):
    """What it makes of targets and angles, or velocities, by one factor, within its limits."""
    servo, gain = SERVOS[kind]
    elbow = '<motor joint="elbow" gear="10"/>'
    file, real = (
        TEXT.format(way=way, shoulder="", elbow='damping="0.1"', motors=servo.format(gain=each) + elbow)
        for each in (gain, 1.4 * gain)
    )
    (tmp_path / "robot.xml").write_text(file)
    body = Body.load(tmp_path / "robot.xml")
    first, second = body.joint_parts
    q, control = in_mujoco(real)
    theta = np.array([first.zero, second.zero]) + np.array([first.sign, second.sign]) * q
    gear, zero = (2.0, first.zero) if kind == "position" else (1.0, 0.0)
    told = servo_torque(first.servo, control[:, 0] / gear * first.sign + zero)
    model = ArmModel(body, np.arange(ROWS) * STEP, command=np.stack([told, second.sign * 10 * control[:, 1]], -1))
    effect = ActuatorGain("shoulder").bound(body)
    model = model.in_substeps(5).with_effects(effect)
    (without,), (with_gain,) = (off_by(model, f"effect.{effect.key}.gain", (gain,), theta) for gain in (0.0, 0.4))
    assert with_gain < 1e-4 < 0.02 < without, (without, with_gain)
