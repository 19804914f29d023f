"""Whatever MuJoCo loads, from a recording: grippers, closed loops, muscles, and feet that share a load."""

import muscled_arms
import numpy as np
import pytest
import torch
from linkages import FOUR_BAR, GRIPPER, crank, grip, play
from scipy.stats import kstest

from invdyn.inference import Bootstrap, ParticleFilter, SMCOptions, infer_engine, infer_states
from invdyn.inference.filters.filtering import run_filters
from invdyn.inference.posterior.engine_contents import contact_lines, engine_contents, generalised_forces
from invdyn.inference.posterior.engine_problem import driven_joints
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import Controls, EngineModel, JointTorques, Keypoints, Observation, Scene
from invdyn.models.engine.needed import reasons
from invdyn.recordings import InputError, Recording

SMALL = {"num_filters": 6, "num_particles": 60, "num_draws": 8}


def held(idata, name, truth):
    """Share of rows, but for the last, whose 90 % band holds the truth (T, n)."""
    draws = idata["posterior"][name].stack(sample=("chain", "draw"), create_index=False).transpose("sample", ...)
    low, high = np.quantile(draws.values, [0.05, 0.95], axis=0)
    return ((low <= truth) & (truth <= high))[:-1].mean(0)


@pytest.mark.long
def test_a_gripper_closes_by_its_tendon():
    recording, force = play(GRIPPER, 30, grip)
    scene = Scene.of(GRIPPER, dimensions=2)
    assert reasons(scene) == ["1 equality constraint", "tendons pull"]
    idata = infer_engine(recording, scene, drive=Controls(), seed=0, **SMALL)
    assert idata["posterior"]["drive"].coords["input"].values.tolist() == ["grip"]
    assert held(idata, "drive", force)[0] > 0.75
    assert {*idata["posterior"]["contact"].values} == {"left_pad-ball", "right_pad-ball"}
    # The ball is light: its two sides push each other through it.
    sides = np.abs(idata["posterior"]["contact_force"].sel(axis="x")).mean(("chain", "draw", "time")).values
    assert sides[0] == pytest.approx(sides[1], rel=0.3)


def test_the_old_name_of_a_method_is_known():
    scene = Scene.of(GRIPPER, dimensions=2)
    still = Recording(
        np.arange(3.0), np.empty((3, 0, 2)), (), angles=np.zeros((3, 1)), joint_names=scene.joint_names[:1]
    )
    with pytest.warns(UserWarning, match="'nested' is now 'smc'"), pytest.raises(InputError, match="of memory"):
        infer_engine(still, scene, method="nested", num_filters=10**9)


@pytest.mark.long
def test_a_closed_loop_says_which_torque_is_not_told():
    """One crank moves a four-bar: with one drive its torque is known, with two only their effect on the loop."""
    recording, torque = play(FOUR_BAR, 28, crank)
    scene = Scene.of(FOUR_BAR, dimensions=2)
    assert reasons(scene) == ["1 equality constraint"]
    one = infer_engine(recording, scene, drive=JointTorques(("crank",)), seed=0, **SMALL)
    assert held(one, "drive", torque)[0] > 0.75
    assert "hidden" not in one.attrs
    two = infer_engine(recording, scene, drive=JointTorques(("crank", "rocker")), seed=0, **SMALL)
    assert "the motion hardly tells rocker" in two.attrs["hidden"]
    widths = [each["posterior"]["drive"].sel(input="crank").std(("chain", "draw")).mean() for each in (one, two)]
    assert float(widths[1]) > 1.1 * float(widths[0])


STANDING = """<mujoco model="standing"><option timestep="0.002" integrator="implicitfast"/>
<default><geom solref=".004 1" solimp=".95 .99 .001"/></default>
<worldbody><geom name="floor" type="plane" size="2 2 .1"/>
  <body name="trunk" pos="0 0 .5"><joint name="height" type="slide" axis="0 0 1"/>
    <geom type="box" size=".2 .1 .05" mass="4" contype="0" conaffinity="0"/><site name="trunk"/>
    <body name="left" pos="-.15 0 -.25"><joint name="left" type="slide" axis="0 0 -1" damping="20"/>
      <geom name="left_foot" size=".05" pos="0 0 -.2" mass=".3"/><site name="left" pos="0 0 -.2"/></body>
    <body name="right" pos=".15 0 -.25"><joint name="right" type="slide" axis="0 0 -1" damping="20"/>
      <geom name="right_foot" size=".05" pos="0 0 -.2" mass=".3"/><site name="right" pos="0 0 -.2"/></body>
  </body></worldbody></mujoco>"""


@pytest.mark.long
def test_feet_that_stand_together_share_a_load_that_no_motion_tells():
    """The sum of both forces is the weight, and each may be anything that adds up to it."""

    def push(model, data, t):
        data.qfrc_applied[1:] = [15.0 + 6 * np.sin(6 * t), 24.2 - 6 * np.sin(6 * t)]
        return data.qfrc_applied[1:].copy()

    recording, _ = play(STANDING, 40, push, noise=0.003)
    idata = infer_engine(recording, Scene.of(STANDING, dimensions=2), seed=2, **SMALL)
    assert "the motion does not tell how floor-left_foot and floor-right_foot share the load" in idata.attrs["hidden"]
    force = idata["posterior"]["contact_force"].sel(axis="z").isel(time=slice(10, 39)).mean("time")
    assert float(force.sum("contact").mean()) == pytest.approx(4.6 * 9.81, rel=0.08)
    assert float(force.std(("chain", "draw")).mean()) > 3 * float(force.sum("contact").std())
    centre = idata["posterior"]["centre_of_pressure"].sel(axis="x").mean(("chain", "draw", "time")).values
    assert centre == pytest.approx([-0.15, 0.15], abs=0.01)


def test_a_split_is_said_where_forces_make_up_for_each_other():
    rng = np.random.default_rng(0)
    for shared, said in ((-0.86, True), (-0.6, True), (-0.4, False), (0.0, False), (0.9, False)):
        force = np.zeros((400, 10, 2, 3))
        force[..., 2] = 20 + rng.multivariate_normal([0, 0], [[25, 25 * shared], [25 * shared, 25]], 400)[:, None]
        lines = contact_lines(force, ["floor-left", "floor-right"], np.array([True, True]))
        assert any("does not tell how" in line for line in lines) == said


def muscled(rows, noise=0.002, text=muscled_arms.TWO):
    scene = Scene.of(text, dimensions=2)
    time = np.arange(rows) * 0.01
    known = {"emission.keypoint_scale": noise, "initial.angle": 0.8, "initial.angle_scale": 0.2}
    known |= {"initial.velocity_scale": 0.5, "initial.activation_scale": 0.1}
    return EngineModel(scene, time, Observation(Keypoints(["wrist"])), drive=Controls(), parameters=known)


@pytest.mark.long
def test_muscles_agree_with_brute_force():
    """Activations of two muscles at the last row: the look-ahead's filters, and 30,000 blind particles."""
    model = muscled(8, noise=0.01)
    _, rows = model.simulate(seed=3)
    torch.manual_seed(0)
    blind = ParticleFilter(model, Bootstrap(model), num_particles=30_000).run(rows)
    ahead = run_filters(
        model, rows, SMCOptions(num_filters=8, num_particles=300), smoother=gaussian_smoother(model, rows)
    )
    assert float(ahead.log_evidence.mean()) == pytest.approx(float(blind.log_evidence), abs=0.1)
    moments = []
    for result in (blind, ahead):
        weight = (result.log_weights[-1] + result.log_evidence[..., None]).flatten().softmax(0).double()
        state = result.states[-1].reshape(-1, model.state_dim).double()
        mean = weight @ state
        moments.append((mean, (weight @ (state - mean) ** 2).sqrt()))
    (mean, sd), (ours, width) = moments
    assert float(((mean - ours).abs() / sd).max()) < 0.12
    assert float((width / sd - 1).abs().max()) < 0.12


@pytest.mark.slow
def test_ranks_of_muscles_are_even():
    """Simulation-based calibration (Talts et al. 2018) of a one-joint, two-muscle arm, on few simulations."""
    model, ranks = muscled(12), []
    for seed in range(12):
        path, rows = model.simulate(seed=seed)
        found = infer_states(model, rows, num_filters=6, num_particles=50, num_draws=10, seed=seed)
        draws = found["posterior"]["state"].values.reshape(-1, *path.shape)
        for t in (5, 11):
            ranks += [np.mean(draws[:, t, k] < float(path[t, k])) for k in (0, 1, 4, 5)]
    assert kstest(ranks, "uniform").pvalue > 0.01


def test_activations_are_within_their_limits():
    """A state beyond them counts as the limit, as it does in the dynamics."""
    model = muscled(3)
    paths = model.simulate((1, 2), seed=0)[0]
    paths[0, 0, 1, -2:] = torch.tensor([-0.3, 1.4])
    recording = Recording(model.time.numpy(), np.zeros((3, 1, 2)), ("wrist",))
    rows = torch.zeros(1, 2, 3, model.observation_dim)
    found = engine_contents(model, rows[0, 0], recording, None, (), paths, rows).posterior["activation"][1]
    np.testing.assert_allclose(found[0, 0, 1], [0, 1])
    np.testing.assert_allclose(found[0, 1], paths[0, 1, :, -2:].clamp(0, 1))


def test_what_does_not_fit_is_refused():
    scene = Scene.of(GRIPPER, dimensions=2)
    time, points = np.arange(5) * 0.01, np.zeros((5, 1, 2))
    wrong = Recording(time=time, keypoints=points, keypoint_names=("thumb",), name="rec")
    with pytest.raises(
        InputError, match=r"keypoint 'thumb' is no site of gripper, which has left_tip, right_tip, ball"
    ):
        infer_engine(wrong, scene)
    right = Recording(time=time, keypoints=points, keypoint_names=("ball",), name="rec")
    with pytest.raises(InputError, match="expected a method among"):
        infer_engine(right, scene, method="nuts")
    with pytest.raises(InputError, match="keypoints have 2 coordinates, the scene is seen in 3"):
        infer_engine(right, Scene.of(GRIPPER))
    with pytest.raises(InputError, match=r"settings: no parameter torque\.size"):
        infer_engine(right, scene, settings={"torque.size": 1.0})


def test_a_rail_with_a_motor_is_driven_and_one_without_is_not():
    """A cart with a pole: contacts alone move it, unless the file has an actuator at its slide."""
    text = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/><body name="cart" pos="0 0 1">
        <joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/><site name="hub"/>
        <body name="pole"><joint name="pin" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 .5" size=".02" mass=".2"/>
        <site name="tip" pos="0 0 .5"/></body></body></worldbody>{}</mujoco>"""
    motor = '<actuator><motor joint="rail"/></actuator>'
    assert driven_joints(Scene.of(text.format(""), dimensions=2)) == ("pin",)
    assert driven_joints(Scene.of(text.format(motor), dimensions=2)) == ("rail", "pin")


def test_forces_of_a_drive_are_without_gravity_springs_and_damping():
    text = """<mujoco model="sprung"><worldbody><body><joint name="hinge" axis="0 1 0" damping=".5" stiffness="2"/>
    <geom size=".04" pos=".2 0 0" mass=".3"/><site name="hand" pos=".2 0 0"/></body></worldbody></mujoco>"""
    model = EngineModel(text, np.arange(3) * 0.01, drive=JointTorques(("hinge",)))
    states = np.array([[[1.5, 0.3, -2.0], [-0.7, 1.2, 3.0], [np.nan, 0.0, 0.0]]])
    at_hinge, _ = generalised_forces(model, states)
    assert at_hinge[0, :2, 0] == pytest.approx([1.5, -0.7], abs=1e-12)
    assert np.isnan(at_hinge[0, 2]).all()
