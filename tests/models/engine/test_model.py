"""MuJoCo as a state-space model: its three distributions against MuJoCo by hand, for every kind of drive and sensor."""

import pickle
from pathlib import Path

import legs
import mujoco
import numpy as np
import pytest
import torch

from invdyn.inference import check_model
from invdyn.models import BodyError, Encoders, Keypoints, Matern52, Observation, OrnsteinUhlenbeck
from invdyn.models.engine.drives import Controls, Given, Inputs, JointTorques, Wrench, turning_dofs
from invdyn.models.engine.model import EngineModel
from invdyn.models.engine.reactions import joint_reactions
from invdyn.models.engine.readings import Readings
from invdyn.models.engine.scene import Scene
from invdyn.models.engine.typical_forces import typical_forces
from invdyn.models.observation.pinhole import PinholeCameras
from invdyn.models.observation.pixels import Pixels

F64 = torch.float64
MUSCLED = """<mujoco model="muscled"><option timestep="0.002" integrator="RK4"/><worldbody>
  <site name="a" pos="0 0 .1"/><site name="b" pos="0 0 -.1"/>
  <body name="fore"><joint name="elbow" axis="0 1 0" damping=".1" range="-1.5 1.5"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1" contype="0" conaffinity="0"/>
    <site name="front" pos=".06 0 .03"/><site name="back" pos=".06 0 -.03"/><site name="hand" pos=".3 0 0"/></body>
</worldbody>
<tendon><spatial name="flexor"><site site="a"/><site site="front"/></spatial>
  <spatial name="extensor"><site site="b"/><site site="back"/></spatial></tendon>
<actuator><muscle name="flexor" tendon="flexor" force="200"/><muscle name="extensor" tendon="extensor" force="200"/>
</actuator>
<sensor><gyro name="gyro" site="hand"/><tendonpos name="length" tendon="flexor"/></sensor></mujoco>"""
FLOATING = """<mujoco model="floating"><option timestep="0.002"/><worldbody>
  <body name="trunk" pos="0 0 1"><freejoint name="root"/><geom type="box" size=".2 .1 .05" mass="2"/>
    <site name="head" pos=".2 0 .1"/><site name="tail" pos="-.2 .1 0"/>
    <body name="arm" pos=".2 0 0"><joint name="hinge" axis="0 1 0"/><geom size=".04" pos=".2 0 0" mass=".3"/>
    <site name="hand" pos=".2 0 0"/></body></body></worldbody></mujoco>"""


def mean_of(model, state, t=1):
    return model.transition(state, t).base_dist.loc


def test_the_leg_moves_as_mujoco_moves_it():
    """The drive lies on a straight line to its mean, at the middle of each step."""
    model = EngineModel(legs.leg_file("hop"), np.arange(5) * 0.01, drive=JointTorques(("hip", "knee")))
    state = torch.tensor([3.0, -2.0, -0.11, -0.6, 1.2, -0.5, 0.3, -0.2], dtype=F64)
    found = mean_of(model, state)
    compiled = mujoco.MjModel.from_xml_string(legs.leg_file("hop"))
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:] = state[2:5], state[5:]
    fade = np.exp(-5.0 * 0.01)
    for k in range(10):
        share = (k + 0.5) / 10
        data.qfrc_applied[1:] = state[:2].numpy() * (1 - share * (1 - fade))
        mujoco.mj_step(compiled, data)
    assert data.ncon > 0
    assert found[:2] == pytest.approx(state[:2].numpy() * fade)
    assert found[2:] == pytest.approx(np.concatenate([data.qpos, data.qvel]), abs=1e-9)
    assert model.nonsmooth


def test_states_that_go_on_are_not_simulated_again(monkeypatch):
    """Filters resample between asking for a row's means and drawing from them."""
    model = EngineModel(legs.leg_file("hop"), np.arange(5) * 0.01, drive=JointTorques(("hip", "knee")))
    states = torch.randn(4, model.state_dim, dtype=F64, generator=torch.Generator().manual_seed(0))
    means = model.moved(states, 2)
    monkeypatch.setattr(model.simulator, "run", None)  # so that a call of it raises
    np.testing.assert_array_equal(model.moved(states[[3, 0, 3]], 2), means[[3, 0, 3]])
    for other, row in ((states, 1), (states + 1e-9, 2)):
        with pytest.raises(TypeError):
            model.moved(other, row)


def test_joints_bear_what_sensors_in_them_measure():
    """MuJoCo's sensors see forces in their site's frame, which is the shank's, at the knee's anchor."""
    sensed = "<sensor><force site='knee'/><torque site='knee'/></sensor></mujoco>"
    text = legs.leg_file("hop").replace("</mujoco>", sensed)
    model = EngineModel(text, np.arange(5) * 0.01, drive=JointTorques(("hip", "knee")))
    states = torch.tensor([[3.0, -2.0, -0.14, -0.6, 1.2, -0.5, 0.3, -0.2], [0, 9, 0.1, 0.5, -1, 0, -3, 4]], dtype=F64)
    states = torch.cat([states, torch.full((1, 8), np.nan, dtype=F64)])
    names, wrench = joint_reactions(model, states[None].numpy())
    assert names == ("trunk", "thigh", "shank")
    assert wrench.shape == (1, 3, 3, 9)
    assert np.isnan(wrench[0, 2]).all()
    compiled = mujoco.MjModel.from_xml_string(text)
    data, contacts = mujoco.MjData(compiled), []
    for state, found in zip(states[:2].numpy(), wrench[0], strict=False):
        data.qpos[:], data.qvel[:], data.qfrc_applied[1:] = state[2:5], state[5:], state[:2]
        mujoco.mj_forward(compiled, data)
        contacts.append(data.ncon)
        axes = data.site("knee").xmat.reshape(3, 3)
        theirs = np.concatenate([axes @ data.sensordata[:3], axes @ data.sensordata[3:]])
        assert found[2] == pytest.approx([*theirs, *data.site("knee").xpos], rel=1e-6, abs=1e-6)
        # About the knee's own axis it is the drive less damping and rotor; the trunk's rail bears nothing upwards.
        own = state[1] - 0.05 * state[7] - 0.005 * data.qacc[2]
        assert found[2, 4] == pytest.approx(own, abs=1e-5)
        assert found[0, 2] == pytest.approx(0, abs=1e-4)
        assert found[0, 6:] == pytest.approx(data.body("trunk").xpos)  # the anchor of MuJoCo's own stays on the rail
    assert contacts[0] > 0 == contacts[1]
    again = joint_reactions(model, states[None, [1, 0]].numpy())[1]
    np.testing.assert_array_equal(again[:, ::-1], wrench[:, :2])  # whatever came before


def test_muscles_are_driven_by_excitations_and_keep_activations():
    model = EngineModel(MUSCLED, np.arange(6) * 0.01, drive=Controls())
    assert model.state_dim == 2 + 2 + 2
    assert model.state_names == (
        *("drive_flexor", "drive_extensor", "angle_elbow", "velocity_elbow"),
        *("activation_0", "activation_1"),
    )
    state = torch.tensor([1.5, -0.5, 0.2, 0.0, 0.7, 0.1], dtype=F64)
    found = mean_of(model, state)
    compiled = mujoco.MjModel.from_xml_string(MUSCLED)
    data, fade = mujoco.MjData(compiled), np.exp(-5.0 * 0.01)
    data.qpos[:], data.act[:] = 0.2, [0.7, 0.1]
    for k in range(5):
        z = state[:2] * (1 - (k + 0.5) / 5 * (1 - fade))
        data.ctrl[:] = torch.special.ndtr(z - 1)
        mujoco.mj_step(compiled, data)
    assert found[2:] == pytest.approx(np.concatenate([data.qpos, data.qvel, data.act]), abs=1e-9)
    assert model.inputs.values(np.array([[9.0, -9.0]])) == pytest.approx(np.array([[1.0, 0.0]]), abs=1e-6)


def test_a_wrench_pushes_a_floating_body_and_rotations_have_a_chart():
    model = EngineModel(FLOATING, np.arange(4) * 0.02, drive=[Wrench("trunk"), JointTorques(("hinge",))])
    names = [f"trunk_{name}" for name in ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")]
    assert list(model.inputs.names) == [*names, "hinge"]
    rng = np.random.default_rng(0)
    state = torch.as_tensor(rng.normal(size=model.state_dim) * 0.5)
    found = mean_of(model, state).numpy()
    compiled = mujoco.MjModel.from_xml_string(FLOATING)
    data, fade = mujoco.MjData(compiled), np.exp(-5.0 * 0.02)
    mujoco.mj_integratePos(compiled, data.qpos, state[7:14].numpy(), 1.0)
    data.qvel[:] = state[14:]
    for k in range(10):
        z = state[:7].numpy() * (1 - (k + 0.5) / 10 * (1 - fade))
        data.xfrc_applied[1], data.qfrc_applied[6] = z[:6], z[6]
        mujoco.mj_step(compiled, data)
    tangent = np.empty(7)
    mujoco.mj_differentiatePos(compiled, tangent, 1.0, compiled.qpos0, data.qpos)
    assert found[7:14] == pytest.approx(tangent, abs=1e-9)
    assert found[14:] == pytest.approx(data.qvel, abs=1e-9)


def test_drives_have_a_usual_size_and_add_to_what_is_given():
    """A motor without limits is as large as its gear lets it be, a wrench as the weight and its lever are."""
    motor = '<actuator><motor name="motor" joint="hinge" gear="5"/></actuator></mujoco>'
    model = mujoco.MjModel.from_xml_string(FLOATING.replace("</mujoco>", motor))
    assert turning_dofs(model).tolist() == [False] * 3 + [True] * 4
    given = Given(forces=np.arange(14.0).reshape(2, 7))
    inputs = Inputs([JointTorques(("hinge",)), Controls(), Wrench("trunk")], model, given)
    weight = 0.3 * 2.3 * 9.81
    expected = [2.0, 2.0 / 5, *[weight] * 3, *[weight * 0.1 * model.stat.extent] * 3]
    assert inputs.scale(model, np.full(7, 2.0)) == pytest.approx(expected)
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, inputs.fields(np.array([0.5, 3.0, *np.zeros(6)]), np.array(1)), inputs.spec)
    assert data.qfrc_applied.tolist() == [7, 8, 9, 10, 11, 12, 13.5]
    assert data.ctrl.tolist() == [3.0]
    with pytest.raises(BodyError, match="expected a name of its own"):
        Inputs([JointTorques(("hinge",)), JointTorques(("hinge",))], model)


def test_sensors_see_what_mujoco_shows():
    """Keypoints in the plane and in space, encoders, the file's own sensors, and the pixels of a camera."""
    observation = Observation(Keypoints(["hand"]), Encoders(), Readings())
    model = EngineModel(MUSCLED, np.arange(3) * 0.01, observation, drive=Controls())
    state = torch.tensor([0.0, 0.0, 0.4, 1.5, 0.3, 0.2], dtype=F64)
    row = model.emission(state, 0).base_dist.loc.numpy()
    compiled = mujoco.MjModel.from_xml_string(MUSCLED)
    data = mujoco.MjData(compiled)
    data.qpos[:], data.qvel[:] = 0.4, 1.5
    mujoco.mj_forward(compiled, data)
    expected = np.concatenate([data.site("hand").xpos, data.qpos, data.sensordata])
    assert row == pytest.approx(expected, abs=1e-9)
    flat = EngineModel(Scene.of(MUSCLED, dimensions=2), np.arange(3) * 0.01, Observation(Keypoints(["hand"])))
    shown = flat.emission(torch.tensor([0.0, 0.4, 0.0, 0.0, 0.0], dtype=F64), 0).base_dist.loc
    assert shown == pytest.approx(data.site("hand").xpos[[0, 2]], abs=1e-9)
    axes = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=F64)  # it looks along y, 2 m off
    one = {"focal": [[900.0, 800]], "center": [[640.0, 360]], "distortion": [[0.0] * 5], "translation": [[0.0, 0, 2]]}
    limit = torch.full((1,), torch.inf)
    camera = PinholeCameras(**{k: torch.tensor(v, dtype=F64) for k, v in one.items()}, rotation=axes[None], limit=limit)
    pixels = Pixels(camera, ("left",), torch.tensor([[1280.0, 720]]), ("hand",), lasting=False)
    filmed = EngineModel(MUSCLED, np.arange(3) * 0.01, Observation(pixels), drive=Controls())
    x, y, z = data.site("hand").xpos
    expected = [900 * x / (y + 2) + 640, -800 * z / (y + 2) + 360]
    assert filmed.emission(state, 0).base_dist.loc == pytest.approx(expected, abs=1e-9)


def test_many_states_and_rows_at_once_are_the_same_as_one_by_one():
    times = np.array([0, 0.01, 0.02, 0.04, 0.05])
    model = EngineModel(Scene.of(legs.leg_file("stance"), dimensions=2), times)
    check_model(model, np.zeros((5, 8)), needs=("gaussian_transition", "constant_covariance", "transition_density"))
    each = np.ceil(np.diff(times, prepend=-0.01) / model.scene.model.opt.timestep - 1e-6)
    assert model.steps_per_row == pytest.approx(each.mean())
    path, rows = model.simulate((3,), seed=0)
    assert torch.isfinite(path).all()
    assert torch.isfinite(rows).all()
    every = mean_of(model, path[:, :-1], torch.arange(1, 5))
    for t in range(1, 5):
        for own, state in zip(every[:, t - 1], path[:, t - 1], strict=True):
            assert torch.equal(own, mean_of(model, state, t))


def test_limbs_that_carry_a_base_may_hold_all_of_it():
    """By levers: at the knee hang shank and foot, or stand trunk and thigh; the hip bears what the knee does."""
    scene = Scene.of(legs.leg_file("hop"))
    hanging, standing = typical_forces(scene, (0, 1, 2)), typical_forces(scene, (1, 2))
    hip, knee = np.random.default_rng(0).uniform(-1, 1, (20, 3))[1:, 1:].T  # poses, the first of which is straight
    foot = 1000 * 4 / 3 * np.pi * 0.025**3
    assert hanging[2] == pytest.approx(9.81 * (0.3 * 0.125 + foot * 0.25) * np.abs(np.sin(hip + knee)).max())
    assert standing[2] == pytest.approx(9.81 * (3 * 0.25 + 0.5 * 0.125) * np.abs(np.sin(hip)).max())
    assert standing[0] == pytest.approx(hanging[0])
    assert hanging[1] < standing[1] == standing[2]


def test_joints_bear_what_motors_beyond_them_do_about_the_same_axis():
    """A spring of 30 N·m/rad on a hinge 120° off the first one's axis, beyond a slide; its pull stays with slides."""
    speck = '<inertial pos="0 0 0" mass=".01" diaginertia=".01 .01 .01"/>'
    axis = np.array([-np.sin(np.pi / 3), 0, -np.cos(np.pi / 3)])
    scene = Scene.of(
        f'<mujoco><option gravity="0 0 0"/><worldbody><site name="post"/><body>{speck}<joint axis="0 0 1"/>'
        f'<body pos="1 0 0">{speck}<joint type="slide" axis="0 1 0"/>'
        f'<body>{speck}<joint axis="{axis[0]} 0 {axis[2]}" stiffness="30"/>'
        f'<body>{speck}<joint type="slide" axis="0 1 1" stiffness="40"/>'
        "</body></body></body></body></worldbody></mujoco>"
    )
    poses = np.random.default_rng(0).uniform(-1, 1, (20, 4))[1:]
    turn, push = 30 * np.abs(poses[:, 2]), 40 * np.abs(poses[:, 3])
    # The last slide's axis turns with the hinge (Rodrigues): its share along y is what the first slide bears.
    own, angle = np.array([0, 1, 1]) / 2**0.5, poses[:, 2, None]
    turned = own * np.cos(angle) + np.cross(axis, own) * np.sin(angle) + axis * (axis @ own) * (1 - np.cos(angle))
    expected = [turn.max() / 2, (push * np.abs(turned[:, 1])).max(), turn.max(), push.max()]
    assert typical_forces(scene) == pytest.approx(expected, rel=1e-6)


def turret(root: str, motors: str = "") -> Scene:
    """A base of 50 kg on a ``root`` joint with two links of 1 kg in the vertical plane, unlimited motors at all."""
    link = '<joint name="{}" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass="1"/>'
    return Scene.of(
        f'<mujoco model="turret"><worldbody><body name="base">{root}<geom type="box" size=".2 .2 .1" mass="50"/>'
        f'<body name="upper" pos=".4 0 0">{link.format("shoulder")}<body name="fore" pos=".2 0 0">'
        f'{link.format("elbow")}<site name="tip" pos=".2 0 0"/></body></body></body></worldbody>'
        f'<actuator><motor joint="shoulder"/><motor joint="elbow"/>{motors}</actuator></mujoco>'
    )


@pytest.mark.parametrize(
    ("root", "falls"),
    [
        ('<joint type="hinge" axis="0 0 1" name="root"/>', 0.0),
        ('<joint type="hinge" axis="0 1 0" name="root"/>', 0.0),
        ('<joint type="ball" name="root"/>', 0.0),
        ('<joint type="slide" axis="1 0 0" name="root"/>', 0.0),
        ('<joint type="slide" axis="1 0 1" name="root"/>', 0.5**0.5),
        ('<joint type="slide" axis="0 0 1" name="root"/>', 1.0),
        ('<freejoint name="root"/>', 1.0),
    ],
)
def test_limbs_carry_a_base_only_where_it_can_fall(root, falls):
    """A bearing takes the rest: a turret's links hold themselves, .98 N·m of the elbow's and 4.9 of the shoulder's."""
    scene = turret(root)
    model = EngineModel(scene, np.arange(4) * 0.01, drive=Controls())
    limbs = typical_forces(scene, JointTorques(("shoulder", "elbow")).bound(scene.model).places)[-2:]
    assert typical_forces(scene, model.inputs.pushed(scene.model))[-2:] == pytest.approx(limbs)
    shoulder, elbow = (1 + 3) * 9.81 * 0.1, 9.81 * 0.1
    usual = OrnsteinUhlenbeck().defaults(torch.tensor([limbs.max()], dtype=F64))["torque.scale"]
    assert model.parameters["torque.scale"].numpy() == pytest.approx(usual.repeat(2).numpy())
    if falls:  # all that is not beyond the elbow, within .1 m to .5 m
        assert 51 * 9.81 * falls * 0.1 < limbs[1] < 51 * 9.81 * falls * 0.7
    else:
        assert limbs == pytest.approx([shoulder, elbow])


def test_a_base_that_an_actuator_lifts_is_not_carried_by_limbs():
    lift = turret('<joint type="slide" axis="0 0 1" name="root"/>', '<motor joint="root" name="lift"/>')
    driven = EngineModel(lift, np.arange(4) * 0.01, drive=Controls()).inputs.pushed(lift.model)
    assert sorted(driven) == [0, 1, 2]
    assert typical_forces(lift, driven)[2] == pytest.approx(9.81 * 0.1)


def test_usual_forces_hold_springs_and_accelerate_inertias():
    """Of a wheel that nothing else loads, of 0.1 + 2 · 0.5² kg·m², of a spring of 40 N/m, and of a speck."""
    inertial = '<inertial pos="{} 0 0" mass="{}" diaginertia="{} {} {}"/></body>'
    wheel, speck = (inertial.format(*each) for each in ((0.5, 2, 0.1, 0.1, 0.1), (0, 1e-9, 1e-9, 1e-9, 1e-9)))
    scene = Scene.of(
        '<mujoco><compiler autolimits="false"/><worldbody><site name="post"/>'
        f'<body name="wheel"><joint name="hub" axis="0 0 1"/>{wheel}'
        f'<body name="sled"><joint name="rail" type="slide" axis="1 0 0" stiffness="40"/>{speck}'
        f'<body name="speck"><joint name="pin" axis="0 0 1"/>{speck}</worldbody></mujoco>'
    )
    poses = np.random.default_rng(0).uniform(-1, 1, (20, 3))[1:]  # about the reference, which is the first
    assert typical_forces(scene) == pytest.approx([5 * 0.6, 40 * np.abs(poses[:, 1]).max(), 1e-6])


def test_processes_of_any_kind_drive_it():
    model = EngineModel(legs.leg_file("hop"), np.arange(4) * 0.01, torque=Matern52())
    path, _ = model.simulate(seed=1)
    assert path.shape == (4, 3 * 3 + 6)
    assert torch.isfinite(path).all()
    assert model.transition(path[:-1], torch.arange(1, 4)).scale_tril.shape == (3, 15, 15)


def test_it_travels_to_workers_and_needs_no_slopes():
    model = EngineModel(legs.leg_file("hop"), np.arange(4) * 0.01)
    state = torch.zeros(model.state_dim, dtype=F64)
    before = mean_of(model, state)
    assert torch.equal(mean_of(pickle.loads(pickle.dumps(model)), state), before)
    with pytest.raises(BodyError, match="no derivative here: use smc"):
        model.transition(state.requires_grad_(), 1)


def test_poses_explain_the_rows():
    """Without noise the path through the rows is the true one."""
    leg = legs.leg_recording("hop", 0, rows=40, noise=0.0)
    model = EngineModel(Scene.of(leg.text, dimensions=2), leg.time, parameters={"emission.keypoint_scale": 0.002})
    rows = torch.as_tensor(leg.rows)
    rows[10:13] = torch.nan
    path = model.initial_paths(rows)[0].numpy()
    seen = np.r_[5:8, 18:36]
    off = path[seen, 3:6] - leg.states[seen, 2:5]
    assert np.sqrt((off**2).mean(0)) == pytest.approx(np.zeros(3), abs=0.03)  # a smoothed path cuts impacts off


BAD = {
    "an empty world": ("<mujoco/>", "expected a joint, got none"),
    "no MJCF": ("<mujoco><worldbody><body/></worldbody></mujoco", "not well-formed|no element|XML"),
    "a start inside the floor": (
        legs.leg_file("hop").replace('pos="0 0 .55"', 'pos="0 0 .4"'),
        r"foot starts 0\.125 m inside floor: move the body",
    ),
    "what runs away": (
        legs.leg_file("hop").replace("</worldbody>", "</worldbody><actuator>"
        '<general joint="knee" biastype="affine" gainprm="0" biasprm="5 -1e7 0"/></actuator>'),
        "the simulation runs away by itself",
    ),
    "a body without mass": (
        legs.leg_file("hop").replace('mass=".3"', 'mass="0"').replace('name="foot" type', 'name="foot" mass="0" type'),
        "mass and inertia of moving bodies must be larger",
    ),
    "a mesh that is not there": (
        legs.leg_file("hop").replace("<worldbody>", '<asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
        '<geom type="mesh" mesh="m"/>'),
        r"model\.xml: names 'gone\.stl', which is no file",
    ),
    "a URDF": ('<robot name="arm"><link name="base"/></robot>', "expected MJCF, with <mujoco> around it, got <robot>"),
    "too many shapes": (
        legs.leg_file("hop").replace("</worldbody>", '<geom size=".01" pos="0 0 9"/>' * 600 + "</worldbody>"),
        "expected at most 500 shapes that may touch something, got 60",
    ),
    "a plugin": (
        legs.leg_file("hop").replace("<worldbody>", '<extension><plugin plugin="a.b"/></extension><worldbody>'),
        r"plugins \(a\.b\) are no part of a state",
    ),
    "a mass that is no number": (
        legs.leg_file("hop").replace('".3"', '"nan"'), 'expected numbers, got mass="nan" of <geom>'
    ),
    "a misspelt section": (
        legs.leg_file("hop").replace("</worldbody>", "</worldbody><actuators/>"), "unrecognized element"
    ),
    "a damping that drives": (
        legs.leg_file("hop").replace('damping=".05"', 'damping="-100"'), "the inertia at knee is not above 0"
    ),
    "no timestep": (
        legs.leg_file("hop").replace('timestep="0.001"', 'timestep="0"'), "expected a timestep above 0 s, got 0"
    ),
    "too many joints": (
        legs.leg_file("hop").replace("<worldbody>", "<worldbody>" + '<body><freejoint/><geom size=".1"/></body>' * 40),
        "expected at most 200 degrees of freedom, got 243",
    ),
    "a height field": (
        legs.leg_file("hop").replace("<worldbody>", '<worldbody><geom type="hfield" hfield="h"/>'),
        "a height field is not read",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_models_are_refused_in_one_line(case, tmp_path):
    text, message = BAD[case]
    path = tmp_path / "model.xml"
    path.write_text(text)
    with pytest.raises(BodyError, match=message) as refused:
        Scene.of(Path(path))
    assert "\n" not in str(refused.value)
    assert str(refused.value).count("model.xml") == 1


@pytest.mark.parametrize(
    ("drive", "message"),
    [
        (JointTorques(("ankle",)), "expected joints among height, hip, knee, got 'ankle'"),
        (Controls(), "expected a file with actuators, got none"),
        (Wrench("head"), "expected a body among trunk, thigh, shank, got 'head'"),
    ],
)
def test_bad_drives_are_refused(drive, message):
    with pytest.raises(BodyError, match=message):
        EngineModel(legs.leg_file("hop"), np.arange(3) * 0.01, drive=drive)


def test_bad_sensors_and_parameters_are_refused():
    with pytest.raises(ValueError, match="expected sensors among none, got 'gyro'"):
        EngineModel(legs.leg_file("hop"), np.arange(3) * 0.01, Observation(Readings(("gyro",))))
    with pytest.raises(KeyError, match=r"no parameter torque\.size"):
        EngineModel(legs.leg_file("hop"), np.arange(3) * 0.01, parameters={"torque.size": 1.0})
