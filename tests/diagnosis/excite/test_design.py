"""Motions to record next: within limits, at rest at both ends, and more telling than random ones."""

import json
import warnings

import numpy as np
import pytest
import torch

from invdyn.diagnosis import design_motion
from invdyn.diagnosis.excite.information import KINDS, Information
from invdyn.diagnosis.excite.limits import MotionLimits, motion_limits
from invdyn.diagnosis.excite.open_questions import open_effects
from invdyn.diagnosis.excite.trajectory import Family
from invdyn.models import Link, load_body, planar_body
from invdyn.recordings import InputError

ARM = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.4, 1.5), Link("fore", "elbow", "wrist", 0.3, 0.8)],
    gravity=(0.0, -9.81),
)
FREE = np.full((2, 2), [-np.inf, np.inf])


def limits(**changed):
    given = {
        "low": np.array([-2.5, 0.1]),
        "high": np.array([-0.5, 2.0]),
        "speed": np.array([2.0, 3.0]),
        "acceleration": np.array([8.0, 10.0]),
        "torque": np.array([40.0, 10.0]),
        "space": FREE,
    }
    return MotionLimits(**given | changed)


@pytest.fixture(scope="module")
def motion():
    return design_motion(ARM, limits=limits(), seconds=8, starts=1, seed=1)


def test_motion_keeps_to_limits_and_rests_at_its_ends(motion):
    own = limits()
    assert (motion.angle > own.low - 1e-9).all()
    assert (motion.angle < own.high + 1e-9).all()
    step = motion.time[1]
    # between the rows of the search waves of a hertz rise by 5 % at most
    assert (np.abs(motion.velocity) < 1.05 * own.speed).all()
    assert (np.abs(motion.acceleration) < 1.05 * own.acceleration).all()
    assert (np.abs(motion.torque) <= own.torque).all()
    np.testing.assert_allclose(motion.velocity[[0, -1]], 0, atol=1e-9)
    np.testing.assert_allclose(motion.acceleration[[0, -1]], 0, atol=1e-9)
    middle = slice(1, -1)
    np.testing.assert_allclose(np.gradient(motion.angle, step, axis=0)[middle], motion.velocity[middle], atol=2e-3)
    np.testing.assert_allclose(
        np.gradient(motion.velocity, step, axis=0)[middle], motion.acceleration[middle], atol=0.05
    )


def test_motion_tells_more_than_a_random_one_and_is_reproducible(motion):
    assert motion.nats > motion.usual + 5
    again = design_motion(ARM, limits=limits(), seconds=8, starts=1, seed=1)
    np.testing.assert_array_equal(again.angle, motion.angle)


def test_a_narrow_space_and_weak_motors_are_kept_to():
    """The elbow stays above the floor and the shoulder's motor is weak: the arm moves about a level pose."""
    given = limits(
        low=np.array([-1.0, -1.0]),
        high=np.array([1.0, 1.0]),
        torque=np.array([9.0, 3.0]),
        space=np.array([[-np.inf, np.inf], [-0.25, 0.35]]),
    )
    found = design_motion(ARM, limits=given, seconds=6, starts=1)
    first, both = found.angle[:, 0], found.angle.sum(1)
    wrist = 0.4 * np.sin(first) + 0.3 * np.sin(both)
    assert ((wrist > -0.25) & (wrist < 0.35)).all()
    assert (np.abs(found.torque) <= given.torque).all()


def test_limits_that_a_standing_robot_exceeds_are_refused():
    weak = limits(low=np.array([-0.1, -0.1]), high=np.array([0.1, 0.1]), torque=np.array([1.0, 1.0]))
    with pytest.raises(InputError, match="torque of joint 'shoulder' is beyond its limit even where the robot stands"):
        design_motion(ARM, limits=weak, seconds=4, starts=1)
    with pytest.raises(InputError, match="2 to 3,600 s, got 1"):
        design_motion(ARM, limits=limits(), seconds=1)
    with pytest.raises(InputError, match="unknown joint 'knee'"):
        design_motion(ARM, limits=limits(), joints=["knee"])


def test_one_joint_moves_and_one_effect_is_asked_about(motion):
    found = design_motion(ARM, limits=limits(), joints=["elbow"], about=["coulomb_friction"], seconds=4, starts=1)
    np.testing.assert_allclose(found.angle[:, 0], -1.5, atol=1e-12)
    assert np.ptp(found.angle[:, 1]) > 0.5
    hidden = {(column.effect, column.place) for column in found.hidden}
    assert ("coulomb_friction", "shoulder") in hidden
    assert ("coulomb_friction", "elbow") not in hidden
    assert 0 < found.nats < motion.nats


def test_information_is_that_of_a_linear_gaussian_model():
    """Posterior sds and nats as by brute force, from columns by differences of the inverse dynamics."""
    own = limits()
    information = Information(ARM, own, noise=0.3)
    family = Family(own, 4.0, 10.0)
    path = family.path(family.start(torch.Generator().manual_seed(3)))
    precision = information.precision(path, 4.0)
    places = [(c.effect, c.place, c.name) for c in information.columns]
    mass = places.index(("inertial_error", "fore", "mass"))
    first = places.index(("inertial_error", "fore", "first moment"))
    heavier = ARM.parameters()
    heavier = heavier._replace(mass=heavier.mass * torch.tensor([1.0, 1.25]))
    extra = (information.dynamics.inverse(*path, heavier) - information.torque(path)).numpy()
    # .2 kg more with the same centre and moments about it: m, m c and J all grow
    second = places.index(("inertial_error", "fore", "second moment"))
    sizes = np.array([c.size for c in information.columns])
    direction = np.zeros(len(sizes))
    direction[[mass, first, second]] = 0.2, 0.2 * 0.15, 0.2 * 0.15**2
    scaled = direction / sizes
    rows = 20 * 4.0 / len(path.q)
    expected = rows * (extra**2).sum() / 0.3**2
    assert scaled @ precision.numpy() @ scaled == pytest.approx(expected, rel=1e-6)
    A = precision.numpy() + np.eye(len(sizes))
    assert information.nats(precision).item() == pytest.approx(0.5 * np.linalg.slogdet(A)[1])
    np.testing.assert_allclose(information.sds(precision), sizes * np.sqrt(np.diag(np.linalg.inv(A))))
    some = Information(ARM, own, about=["armature"], noise=0.3)
    other = ~some.about.numpy()
    expected = 0.5 * (np.linalg.slogdet(A)[1] - np.linalg.slogdet(A[other][:, other])[1])
    assert some.nats(precision).item() == pytest.approx(expected)


def test_limits_of_a_table(tmp_path):
    table = tmp_path / "limits.toml"
    table.write_text(
        "[all]\nspeed = 1.5\ntorque = 30\n[shoulder]\nposition = [-2.0, -1.0]\n"
        "[elbow]\nposition = [0.0, 1.0]\ntorque = 5\nacceleration = 2.0\n[space]\ny = [-0.6, 0.1]\n"
    )
    found = motion_limits(ARM, table=table)
    np.testing.assert_array_equal(found.low, [-2, 0])
    np.testing.assert_array_equal(found.torque, [30, 5])
    np.testing.assert_array_equal(found.acceleration, [6, 2])
    np.testing.assert_array_equal(found.space, [[-np.inf, np.inf], [-0.6, 0.1]])
    assert found.assumed == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[shoulder]\nposition = [-1.0, 1.0]\n", "joint 'elbow' has no range"),
        ("[wrist]\nspeed = 1.0\n", "unknown joint 'wrist': expected one of shoulder, elbow"),
        ("[all]\nposition = [1.0, -1.0]\n", r"expected low < high, got \[1.0, -1.0\]"),
        ("[all]\nspeed = 0\n", "expected a speed above 0, got 0"),
        ("[all]\nspeed = true\n", "expected a number, got True"),
        ("[all]\nhaste = 1\n", "unknown 'haste': expected position, speed, acceleration, torque"),
        ("[all]\nposition = [0.0, 1.0]\n[space]\nz = [0.0, 1.0]\n", "expected ranges of x, y"),
    ],
)
def test_wrong_tables_are_refused(tmp_path, text, words):
    table = tmp_path / "limits.toml"
    table.write_text(text)
    with pytest.raises(InputError, match=words):
        motion_limits(ARM, table=table)


def test_limits_of_robot_files(tmp_path):
    pytest.importorskip("mujoco")
    xml = tmp_path / "robot.xml"
    xml.write_text(
        """<mujoco><worldbody><body name="a"><joint name="one" type="hinge" axis="0 1 0" range="-90 45" limited="true"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/><site name="tip" pos=".2 0 0"/></body></worldbody>
        <actuator><motor joint="one" ctrlrange="-7 5" ctrllimited="true"/></actuator></mujoco>"""
    )
    with pytest.warns(UserWarning, match="leave out limits"):
        body = load_body(xml, filmed=False, dimensions=3)
    found = motion_limits(body, xml)
    np.testing.assert_allclose([found.low[0], found.high[0]], [-np.pi / 2, np.pi / 4])
    assert found.torque[0] == 5
    assert found.assumed == ("one: 1 rad/s",)
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(
        """<robot name="r"><link name="base"/><link name="a"><inertial><mass value="1"/><origin xyz=".1 0 0"/>
        <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="one" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
        <limit lower="-1" upper="2" velocity="3" effort="9"/></joint></robot>"""
    )
    with pytest.warns(UserWarning, match="leave out limits"):
        body = load_body(urdf, filmed=False, dimensions=3)
    found = motion_limits(body, urdf)
    assert (found.low[0], found.high[0], found.speed[0], found.torque[0]) == (-1, 2, 3, 9)


def test_open_effects_of_a_diagnosis(tmp_path):
    def cause(probability, *names):
        return {"effects": [{"effect": name} for name in names], "probability": probability}

    causes = [cause(0.6, "viscous_friction", "payload"), cause(0.38, "viscous_friction"), cause(0.02, "armature")]
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"causes": causes, "ambiguity_set": [["actuator_gain.elbow", "camera_scale"]]}))
    assert open_effects(path) == ["actuator_gain", "inertial_error"]
    assert set(open_effects(path)) <= set(KINDS)
    path.write_text("[]")
    with pytest.raises(InputError, match="expected a diagnosis of `invdyn diagnose`"):
        open_effects(path)


def test_torques_count_the_files_own_friction_and_rotors(tmp_path):
    """Against MuJoCo's inverse dynamics of the same motion; its dry friction is left out of both."""
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="one" axis="0 1 0" damping="5"
        armature=".5" stiffness="3" springref=".2" range="-1 1" limited="true"/>
        <inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/><site name="tip" pos=".2 0 0"/></body></worldbody>
        <actuator><motor joint="one" ctrlrange="-9 9" ctrllimited="true"/></actuator></mujoco>"""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # limits are left out of bodies
        (tmp_path / "robot.xml").write_text(text)
        body = load_body(tmp_path / "robot.xml", filmed=False, dimensions=3)
    given = MotionLimits(np.array([-1.0]), np.array([1.0]), *np.full((3, 1), 9.0), np.full((3, 2), [-np.inf, np.inf]))
    found = design_motion(body, limits=given, seconds=4, starts=1)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for q, qd, qdd, torque in zip(found.angle, found.velocity, found.acceleration, found.torque, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        assert data.qfrc_inverse[0] == pytest.approx(torque[0], abs=1e-6)
    assert np.abs(found.torque).max() <= 9.0
