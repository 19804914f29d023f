"""OpenSim's own inverse dynamics of a recorded arm, made of its inverse kinematics by ours.

The model's numbers are read from its file here, all of them; muscles play no part in inverse dynamics.
"""

from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from scipy.interpolate import make_interp_spline

from invdyn.models import Body, Joint, Link, dynamics_for
from invdyn.recordings import load
from invdyn.recordings.formats.opensim import read_sto, write_moments, write_motion


def numbers(element, tag):
    return np.array([float(word) for word in element.find(tag).text.split()])


def arm26(path):
    """Two hinges: each about the first axis of a joint's SpatialTransform, at its parent's frame."""
    model = ElementTree.parse(path).getroot()
    bodies = {body.get("name"): body for body in model.iter("Body")}
    joints = {joint.get("name"): joint for joint in model.iter("CustomJoint")}
    raised = numbers(next(model.iter("WeldJoint")).find("frames/PhysicalOffsetFrame"), "translation")

    def link(name, joint, parent, above):
        axis = numbers(joints[joint].find("SpatialTransform/TransformAxis"), "axis")
        return Link(
            name,
            Joint(joints[joint].find("coordinates/Coordinate").get("name"), axis=tuple(axis / np.linalg.norm(axis))),
            parent=parent,
            origin=above + numbers(joints[joint].find("frames/PhysicalOffsetFrame"), "translation"),
            mass=float(bodies[name].find("mass").text),
            com=numbers(bodies[name], "mass_center"),
            inertia=numbers(bodies[name], "inertia"),
        )

    humerus = link("r_humerus", "r_shoulder", "world", raised)
    forearm = link("r_ulna_radius_hand", "r_elbow", "r_humerus", np.zeros(3))
    return Body("arm26", [humerus, forearm], numbers(model.find("Model"), "gravity"))


def test_inverse_dynamics_of_an_arm(data_folder):
    """OpenSim puts quintic splines that are natural at both ends through the angles; its file has ten digits."""
    folder = data_folder / "opensim_arm26"
    tree, motion = arm26(folder / "arm26.osim"), load(folder / "arm26_InverseKinematics.mot")
    assert motion.joint_names == tree.joint_names
    spline = make_interp_spline(motion.time, motion.angles, k=5, bc_type=([(3, np.zeros(2)), (4, np.zeros(2))],) * 2)
    state = [torch.tensor(spline(motion.time, order)) for order in range(3)]
    ours = dynamics_for(tree).inverse(*state, tree.parameters()).numpy()
    table = read_sto(folder / "arm26_InverseDynamics_Unfiltered.sto")
    theirs = np.stack([table[f"{joint}_moment"] for joint in tree.joint_names], -1)
    off = np.sqrt(((ours - theirs) ** 2).mean(0) / (theirs**2).mean(0))
    assert (off < 1e-7).all()


def test_opensim_reads_what_is_written(tmp_path, monkeypatch):
    """By OpenSim's own reader: the wheel `opensim`, which there is for Linux and Windows on x86-64."""
    monkeypatch.chdir(tmp_path)  # it writes a log where it is loaded
    opensim = pytest.importorskip("opensim")
    time, values = np.linspace(0, 1, 5), np.random.default_rng(0).normal(size=(5, 2))
    write_moments(tmp_path / "t.sto", time, values, values - 1, values + 1, ("r_elbow_flex", "cart"), {"cart"})
    table = opensim.TimeSeriesTable(str(tmp_path / "t.sto"))
    assert table.getColumnLabels()[:2] == ("r_elbow_flex_moment", "cart_force")
    np.testing.assert_allclose(table.getIndependentColumn(), time)
    np.testing.assert_allclose(table.getDependentColumn("cart_force").to_numpy(), values[:, 1], rtol=1e-9)
    write_motion(tmp_path / "t.mot", time, values, ("r_shoulder_elev", "r_elbow_flex"))
    storage = opensim.Storage(str(tmp_path / "t.mot"))
    assert not storage.isInDegrees()
    column = opensim.ArrayDouble()
    storage.getDataColumn("r_elbow_flex", column)
    np.testing.assert_allclose([column.get(i) for i in range(column.getSize())], values[:, 1], rtol=1e-9)
