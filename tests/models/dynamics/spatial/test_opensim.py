"""OpenSim's own inverse dynamics of recorded people, made of its inverse kinematics by ours, with its own models."""

import numpy as np
import pytest
import torch
from scipy.interpolate import make_interp_spline

from invdyn.models import Body, dynamics_for
from invdyn.recordings import load
from invdyn.recordings.formats.opensim import read_sto, write_moments, write_motion


def quintic(time, angles):
    """Angles, rates and accelerations by OpenSim's splines, which are natural at both ends."""
    ends = [(order, np.zeros(angles.shape[1])) for order in (3, 4)]
    spline = make_interp_spline(time, angles, k=5, bc_type=(ends, ends))
    return [torch.tensor(spline(time, order)) for order in range(3)]


def test_inverse_dynamics_of_an_arm(data_folder):
    """OpenSim's file has ten digits."""
    folder = data_folder / "opensim_arm26"
    with pytest.warns(UserWarning, match=r"muscles \(TRIlong, .*; wrapping surfaces \(TRIlongglen"):
        tree = Body.load(folder / "arm26.osim")
    motion = load(folder / "arm26_InverseKinematics.mot")
    assert motion.joint_names == tree.joint_names
    ours = dynamics_for(tree).inverse(*quintic(motion.time, motion.angles), tree.parameters()).numpy()
    table = read_sto(folder / "arm26_InverseDynamics_Unfiltered.sto")
    theirs = np.stack([table[f"{joint}_moment"] for joint in tree.joint_names], -1)
    off = np.sqrt(((ours - theirs) ** 2).mean(0) / (theirs**2).mean(0))
    assert (off < 1e-7).all()


def test_markers_lie_where_they_were_recorded(data_folder):
    """Inverse kinematics laid them within a millimetre of the .trc, whose y is up, too."""
    folder = data_folder / "opensim_arm26"
    with pytest.warns(UserWarning, match="muscles"):
        tree = Body.load(folder / "arm26.osim")
    with pytest.warns(UserWarning, match="z is up here"):
        seen = load(folder / "arm26_elbow_flex.trc")
    motion = load(folder / "arm26_InverseKinematics.mot")
    sites = dynamics_for(tree).keypoints(torch.tensor(motion.angles), tree.parameters()).numpy()
    for place, name in enumerate(tree.keypoint_names):
        np.testing.assert_allclose(sites[:, place], seen.keypoint(name), atol=1e-3)


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
