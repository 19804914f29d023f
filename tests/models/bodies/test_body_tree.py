"""Robots' files as trees: every number as MuJoCo and Pinocchio have it, joints, links and sites by name."""

import warnings

import numpy as np
import pytest
import torch
from robot_files import random_mjcf, random_urdf

from invdyn.models import Body, BodyError
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics

ALIKE = {"rtol": 1e-9, "atol": 1e-9}


def read(text, path, dimensions=None):
    """The body of a file, whatever it leaves out."""
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return Body.load(path, dimensions=dimensions)


def tensors(*arrays):
    return [torch.tensor(array) for array in arrays]


class InMuJoCo:
    """What MuJoCo's own reading of a file says, damping and armature out."""

    def __init__(self, text, joints):
        self.mj = pytest.importorskip("mujoco")
        self.model = self.mj.MjModel.from_xml_string(text)
        self.data = self.mj.MjData(self.model)
        self.model.dof_damping[:] = self.model.dof_armature[:] = self.model.dof_frictionloss[:] = 0
        bits = self.mj.mjtDisableBit
        self.model.opt.disableflags |= bits.mjDSBL_CONSTRAINT | bits.mjDSBL_ACTUATION
        self.order = [self.model.joint(name).qposadr[0] for name in joints]

    def __call__(self, q, qd, qdd, sites):
        """Torques and places of the sites."""
        data = self.data
        data.qpos[self.order], data.qvel[self.order] = q, qd
        self.mj.mj_forward(self.model, data)
        data.qacc[self.order] = qdd
        self.mj.mj_inverse(self.model, data)
        return data.qfrc_inverse[self.order].copy(), np.array([data.site(name).xpos for name in sites])


@pytest.mark.parametrize("seed", range(12))
def test_a_random_mjcf_moves_as_in_mujoco(seed, tmp_path):
    text = random_mjcf(seed)
    tree = read(text, tmp_path / "arm.xml", dimensions=3)
    peer, dynamics, p = InMuJoCo(text, tree.joint_names), SpatialDynamics(tree), tree.parameters()
    assert tree.num_joints == peer.model.nv
    assert set(tree.keypoint_names) == {f"s{body}" for body in range(7) if _moves(peer.model, f"b{body}")}
    rng = np.random.default_rng(seed)
    for _ in range(2):
        q, qd, qdd = rng.uniform(-2, 2, (3, tree.num_joints))
        torque, points = peer(q, qd, qdd, tree.keypoint_names)
        ours = dynamics.inverse(*tensors(q, qd, qdd), p)
        np.testing.assert_allclose(ours, torque, rtol=1e-9, atol=1e-9 * np.abs(torque).max())
        np.testing.assert_allclose(dynamics.keypoints(torch.tensor(q), p), points, **ALIKE)


def _moves(model, body):
    return model.body_weldid[model.body(body).id] != 0


@pytest.mark.parametrize("seed", range(8))
def test_a_random_urdf_moves_as_in_pinocchio(seed, tmp_path):
    pin = pytest.importorskip("pinocchio")
    text = random_urdf(seed)
    tree = read(text, tmp_path / "arm.urdf", dimensions=3)
    model = pin.buildModelFromUrdf(str(tmp_path / "arm.urdf"))
    data, K = model.createData(), tree.num_joints
    order = [model.idx_vs[model.getJointId(name)] for name in tree.joint_names]
    dynamics, p, rng = SpatialDynamics(tree), tree.parameters(), np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 2, (3, K))
    theirs = np.zeros((3, K))
    theirs[:, order] = q, qd, qdd
    # a continuous joint is (cos, sin) in Pinocchio
    place = pin.integrate(model, pin.neutral(model), theirs[0])
    torque = pin.rnea(model, data, place, theirs[1], theirs[2])[order]
    np.testing.assert_allclose(dynamics.inverse(*tensors(q, qd, qdd), p), torque, **ALIKE)
    pin.framesForwardKinematics(model, data, place)
    points = [data.oMf[model.getFrameId(name, pin.FrameType.BODY)].translation for name in tree.keypoint_names]
    np.testing.assert_allclose(dynamics.keypoints(torch.tensor(q), p), points, **ALIKE)


GRIPPER = """<mujoco model="gripper"><compiler angle="radian"/><option density="1.2"/>
  <default><default class="robot"><joint axis="0 0 1" damping="1" range="-2 2" limited="true"/>
    <general biastype="affine" forcerange="-87 87" forcelimited="true"/>
    <default class="finger"><joint type="slide" axis="0 1 0" range="0 0.04"/></default></default></default>
  <worldbody><body name="stand" childclass="robot"><body name="turret" gravcomp="1"><joint name="pan"/>
    <inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .1"/>
    <body name="boom" pos="0 0 .3" quat="1 1 0 0"><joint name="lift"/>
      <inertial pos=".2 0 0" mass="1" diaginertia=".01 .02 .02"/><site name="tool" pos=".4 0 0"/>
      <body name="hand" pos=".4 0 0"><inertial pos="0 0 0" mass=".3" diaginertia="1e-3 1e-3 1e-3"/>
        <body name="left"><joint name="left_slide" class="finger"/>
          <inertial pos="0 0 0" mass=".02" diaginertia="1e-6 1e-6 1e-6"/></body>
        <body name="right" quat="0 0 0 1"><joint name="right_slide" class="finger"/>
          <inertial pos="0 0 0" mass=".02" diaginertia="1e-6 1e-6 1e-6"/></body></body></body></body></body></worldbody>
  <tendon><fixed name="split"><joint joint="left_slide" coef="1"/><joint joint="right_slide" coef="1"/></fixed></tendon>
  <equality><joint joint1="left_slide" joint2="right_slide"/></equality>
  <actuator><general class="robot" name="servo" joint="lift" gainprm="4500" biasprm="0 -4500 -450"/></actuator>
  </mujoco>"""


def test_a_file_with_classes_and_all_that_a_rigid_tree_lacks(tmp_path):
    (tmp_path / "arm.xml").write_text(GRIPPER)
    with pytest.warns(UserWarning, match="leave out") as told:
        tree = Body.load(tmp_path / "arm.xml")
    (line,) = [str(each.message) for each in told]
    for words in (
        "limits (pan, lift, left_slide, right_slide)",
        "gravity compensation (turret)",
        "a fluid",
        "tendons (split)",
        "equality constraints (left_slide follows right_slide)",
    ):
        assert words in line
    assert tree.joint_names == ("pan", "lift", "left_slide", "right_slide")
    assert tree.link_names == ("turret", "boom", "left", "right")
    assert tree.keypoint_names == ("tool",)
    assert [link.joint.type for link in tree.links] == ["hinge", "hinge", "slide", "slide"]
    assert [parts.damping for parts in tree.joint_parts] == [1.0] * 4  # played, as a servo is
    assert (tree.joint_parts[1].servo.gain, tree.joint_parts[1].servo.high) == (4500.0, 87.0)
    assert tree.hand == (1, 0)  # what the fingers hang on
    tree.to_toml(tmp_path / "arm.toml")
    assert Body.load(tmp_path / "arm.toml").joint_parts == tree.joint_parts
    boom = tree.links[1]
    assert boom.mass == pytest.approx(1.3)  # with the hand that is fixed to it
    assert boom.rotation == ((1, 0, 0), (0, 0, -1), (0, 1, 0))  # exact: structural zeros make the dynamics short


def test_which_files_are_planar(tmp_path):
    """A chain about one axis is a planar body, as ever; a turn, a slide or a branch more makes it a tree."""
    hinge = '<joint name="{}" axis="{}"/><inertial pos=".1 0 0" mass="1" diaginertia=".01 .01 .01"/>'
    inner = f'<body name="b" pos=".3 0 0">{hinge.format("two", "{axis}")}<site name="hand" pos=".2 0 0"/></body>'
    file = (
        f'<mujoco><worldbody><body name="a">{hinge.format("one", "0 0 1")}{inner}{{more}}</body></worldbody></mujoco>'
    )
    path = tmp_path / "arm.xml"
    assert read(file.format(axis="0 0 -1", more=""), path).is_chain
    branch = f'<body name="c">{hinge.format("three", "0 0 1")}</body>'
    for axis, more in (("0 1 0", ""), ("0 1 1", ""), ("0 0 1", branch)):
        assert not read(file.format(axis=axis, more=more), path).is_chain
    slide = file.format(axis='1 0 0" type="slide', more="")
    assert read(slide, path).joint_names == ("one", "two")
    with pytest.raises(BodyError, match="of type slide"):
        Body.load(path, dimensions=2)
    assert not read(file.format(axis="0 0 1", more=""), path, dimensions=3).is_chain


def test_points_without_sites_are_the_frames(tmp_path):
    """URDF names points by links alone; a camera's frame fixed to an arm is where its keypoint is."""
    robot = """<robot name="arm"><link name="world"/>
      <link name="arm"><inertial><origin xyz=".1 0 0"/><mass value="1"/>
        <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="camera"/>
      <joint name="j" type="continuous"><parent link="world"/><child link="arm"/><origin xyz="0 0 1"/></joint>
      <joint name="f" type="fixed"><parent link="arm"/><child link="camera"/><origin xyz=".4 0 .1"/></joint></robot>"""
    tree = read(robot, tmp_path / "arm.urdf", dimensions=3)
    assert tree.keypoint_names == ("arm", "camera")
    np.testing.assert_allclose(tree.parameters().sites, [[0, 0, 0], [0.4, 0, 0.1]])


def test_a_ball_and_a_free_joint(tmp_path):
    """Charts of ours stand for MuJoCo's quaternions: the same points where the same turns are meant."""
    mujoco = pytest.importorskip("mujoco")
    text = """<mujoco><worldbody><body name="torso" pos="0 0 1" quat="1 0 1 0"><freejoint name="root"/>
      <inertial pos="0 0 0" mass="3" diaginertia=".1 .2 .25"/><body name="arm" pos=".2 0 0">
      <joint name="shoulder" type="ball" pos=".05 0 0"/><inertial pos="0 0 .1" mass="1" diaginertia=".02 .02 .01"/>
      <site name="hand" pos=".05 0 .3"/></body></body></worldbody></mujoco>"""
    tree = read(text, tmp_path / "arm.xml")
    assert tree.joint_names[3:] == (
        "root_yaw",
        "root_pitch",
        "root_roll",
        *(f"shoulder_{turn}" for turn in ("yaw", "pitch", "roll")),
    )
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    turn = np.array([np.cos(0.35), 0, np.sin(0.35), 0])  # 0.7 about y, pitch
    data.qpos[7:] = turn
    data.qpos[:3] += [0, 0, 0.2]  # up, which the torso's frame has along its own axis
    mujoco.mj_kinematics(model, data)
    q = torch.zeros(tree.num_joints, dtype=torch.float64)
    up = np.array(tree.links[0].rotation).T @ [0, 0, 0.2]
    q[:3], q[tree.joint_names.index("shoulder_pitch")] = torch.tensor(up), 0.7
    ours = SpatialDynamics(tree).keypoints(q, tree.parameters())
    np.testing.assert_allclose(ours[0], data.site("hand").xpos, atol=1e-12)


REFUSED = {
    "no joint": ("<robot name='a'><link name='b'/></robot>", "expected a body with joints, got one without"),
    "no link": ("<robot name='a'/>", "got no link at all"),
    "a planar joint": (
        "<robot name='a'><link name='b'/><link name='c'/><joint name='j' type='planar'><parent link='b'/>"
        "<child link='c'/></joint></robot>",
        "expected joints of type revolute, continuous, prismatic, floating or fixed, 'j' is of type planar",
    ),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_tree_is_refused(text, message, tmp_path):
    with pytest.raises(BodyError, match=message):
        read(text, tmp_path / "arm.urdf")
