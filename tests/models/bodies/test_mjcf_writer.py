"""A body written as MJCF or TOML is the same body when it is read back: the same coordinates, torques and points."""

import warnings
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from trees import MuJoCo, mobile_arm, panda, paper_arm, random_state, random_tree

from invdyn.models import Body, BodyError, Joint, Learned, Link, load_body, write_mjcf
from invdyn.models.bodies.joint_parts import NOTHING, JointParts, Motor
from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics

mujoco = pytest.importorskip("mujoco")
TREES = {
    "paper": paper_arm(),
    "panda": panda(),
    "mobile": mobile_arm(),
    **{f"random {K}": random_tree(K, K) for K in (3, 5, 8)},
}


def moved(tree, joints, sites):
    """Torques and points of one state, in the order of given names; float64 leaves 1e-12 of each."""
    q, qd, qdd = random_state(len(joints), 1)
    order = [joints.index(name) for name in tree.joint_names]
    dynamics, p = SpatialDynamics(tree), tree.parameters()
    torque = dynamics.inverse(q[order], qd[order], qdd[order], p)[[tree.joint_names.index(name) for name in joints]]
    points = dynamics.keypoints(q[order], p)[[tree.keypoint_names.index(name) for name in sites]]
    return torque, points


@pytest.mark.parametrize("tree", TREES.values(), ids=TREES)
def test_a_tree_comes_back_from_mjcf(tree, tmp_path):
    write_mjcf(tree, tmp_path / "arm.xml")
    back = Body.load(tmp_path / "arm.xml", dimensions=3)
    assert set(back.joint_names) == set(tree.joint_names)
    assert set(back.keypoint_names) == set(tree.keypoint_names)
    ours, again = (moved(each, tree.joint_names, tree.keypoint_names) for each in (tree, back))
    torch.testing.assert_close(again[0], ours[0], rtol=1e-12, atol=1e-12 * ours[0].abs().max().item())
    torch.testing.assert_close(again[1], ours[1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", ["panda", "mobile", "random 5"])
def test_mujoco_says_of_the_file_what_it_says_of_the_tree(name, tmp_path):
    """Against a model that the tests write themselves (`trees.MuJoCo`), whose inertials are tensors."""
    tree, peer = TREES[name], MuJoCo(TREES[name])
    write_mjcf(tree, tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    data = mujoco.MjData(model)
    q, qd, qdd = (value.numpy() for value in random_state(tree.num_joints, 2))
    order = [model.joint(each).qposadr[0] for each in tree.joint_names]
    data.qpos[order], data.qvel[order] = q, qd
    mujoco.mj_forward(model, data)
    data.qacc[order] = qdd
    mujoco.mj_inverse(model, data)
    theirs = peer(q, qd, qdd)
    np.testing.assert_allclose(data.qfrc_inverse[order], theirs["inverse"], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose([data.site(s).xpos for s in tree.keypoint_names], theirs["keypoints"], atol=1e-12)


@pytest.mark.parametrize("name", ["paper_planar_arm", "dfki_design_a0", "human_arm_on_table"])
def test_a_planar_body_comes_back_as_one(name, tmp_path):
    body = Body.from_toml(str(files("invdyn.models.bodies") / f"{name}.toml"))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "MJCF cannot say priors", UserWarning)
        write_mjcf(replace(body, uncertainty={}), tmp_path / "arm.xml")
    back = load_body(tmp_path / "arm.xml")
    assert back.is_chain
    for names in ("joint_names", "link_names", "keypoint_names"):
        assert getattr(back, names) == getattr(body, names)
    for ours, again in zip(body.parameters(), back.parameters(), strict=True):
        torch.testing.assert_close(again, ours, rtol=1e-12, atol=1e-12)


def test_a_tree_of_mjcf_comes_back_from_toml(tmp_path):
    """Names that TOML would have to quote are quoted."""
    arm = replace(panda().links[0], sites={"left hand": (0.1, 0.0, 0.0), "marker.3": (0.0, 0.2, 0.0)})
    write_mjcf(Body("arm", [arm, *panda().links[1:]]), tmp_path / "arm.xml")
    tree = Body.load(tmp_path / "arm.xml", dimensions=3)
    tree.to_toml(tmp_path / "arm.toml")
    assert load_body(tmp_path / "arm.toml") == tree


def test_what_mjcf_cannot_say_is_said(tmp_path):
    uncertain = [replace(link, mass=dist.LogNormal(torch.tensor(0.0), torch.tensor(0.1))) for link in panda().links]
    with pytest.warns(UserWarning, match=r"MJCF cannot say priors \(written: their means\)"):
        write_mjcf(Body("arm", uncertain), tmp_path / "arm.xml")
    assert Body.load(tmp_path / "arm.xml", dimensions=3).links[0].mass == pytest.approx(np.exp(0.005))
    learned = replace(panda().links[0], mass=Learned(4.0))
    with pytest.warns(UserWarning, match="cannot say learned scalars"):
        write_mjcf(Body("arm", [learned, *panda().links[1:]]), tmp_path / "arm.xml")


def test_what_a_joint_has_besides_comes_back(tmp_path):
    parts = JointParts(damping=0.3, friction=0.1, armature=0.02, stiffness=2.0, rest=0.4)
    links = panda().links
    write_mjcf(Body("arm", [*links[:3], replace(links[3], parts=parts), *links[4:]]), tmp_path / "arm.xml")
    others = (NOTHING,) * 3
    assert Body.load(tmp_path / "arm.xml", dimensions=3).joint_parts == (*others, parts, *others)
    servo = replace(links[3], parts=JointParts(motor=Motor("position", 40.0, 40.0)))
    with pytest.warns(UserWarning, match="cannot say limits and servos of motors"):
        write_mjcf(Body("arm", [*links[:3], servo, *links[4:]]), tmp_path / "arm.xml")


def test_moments_that_no_rigid_body_has(tmp_path):
    """About one direction alone any tensor will do, and MuJoCo gets one that it takes; elsewhere the user is told."""
    flat = Link("disc", Joint("axle"), mass=1.0, com=(0.1, 0.0, 0.0), inertia=(0.0, 0.0, 0.3, 0, 0, 0))
    write_mjcf(Body("wheel", [flat]), tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert model.body_inertia[1] == pytest.approx([0.3] * 3)
    rounded = replace(flat, joint=Joint("ball", "ball"), inertia=(0.1, 0.2, 0.30001, 0, 0, 0))
    with pytest.raises(BodyError, match="link 'disc': MuJoCo wants principal moments"):
        write_mjcf(Body("wheel", [rounded]), tmp_path / "arm.xml")


def test_massless_links_are_joints_of_what_they_carry(tmp_path):
    yaw = Link("gimbal", Joint("yaw"))
    arm = Link("arm", Joint("pitch", axis=(0, 1, 0)), parent="gimbal", origin=(0, 0, 0.2), mass=1.0, com=(0.2, 0, 0))
    arm = replace(arm, inertia=(0.01, 0.02, 0.02, 0, 0, 0))
    write_mjcf(Body("arm", [yaw, arm]), tmp_path / "arm.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert (model.nbody, model.njnt) == (2, 2)
    seen = replace(yaw, sites={"ring": (0.1, 0, 0)})
    with pytest.raises(BodyError, match="link 'gimbal': MuJoCo has no massless link that moves"):
        write_mjcf(Body("arm", [seen, arm]), tmp_path / "arm.xml")
