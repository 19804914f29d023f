"""`invdyn infer` takes MuJoCo's engine where a body's file needs it, says why, and writes what it found."""

import legs
import numpy as np
import pandas as pd
import pytest
from robot_xml import robot

from invdyn.inference import load_posterior
from invdyn.models.engine.needed import reasons_for_engine
from invdyn.outputs import OutputFiles
from invdyn.recordings import Recording, read_sto, write_keypoint_csv

ROWS = 16
FEW = ("--filters", "2", "--particles", "30", "--set", "draws=4", "--set", "drive=joints")


@pytest.fixture
def leg(tmp_path):
    """A leg that lands, and its file."""
    played = legs.leg_recording("hop", 0, rows=60)
    part = slice(30, 30 + ROWS)
    (tmp_path / "leg.xml").write_text(played.text)
    points = played.rows[part].reshape(ROWS, 4, 2)
    seen = Recording(time=played.time[part], keypoints=points, keypoint_names=legs.SITES, name="leg")
    write_keypoint_csv(seen, tmp_path / "leg.csv")
    return tmp_path


@pytest.mark.long
def test_a_leg_from_its_file_to_its_forces(leg, run):
    outcome = run("infer", leg / "leg.csv", "--body", leg / "leg.xml", *FEW, "--out", leg / "p.nc", "--out",
                  leg / "p.csv", "--out", leg / "p.png", "--out", leg / "p.sto")  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    assert "dynamics by MuJoCo: contact of trunk, thigh, shank with the world" in outcome.output
    assert "contact floor-foot: " in outcome.output
    saved = load_posterior(leg / "p.nc")
    force = saved["posterior"]["contact_force"]
    assert force.attrs["units"] == "N"
    assert float(force.sel(axis="z").mean()) > 5
    table = pd.read_csv(leg / "p.csv")
    assert (table["floor-foot_force_z_q05"] <= table["floor-foot_force_z_q95"]).all()
    assert np.isfinite(table["hip_torque"]).all()
    # What the knee bears from below is the floor's push less what the shank needs of it: of .3 kg, and from row on.
    for_opensim = read_sto(leg / "p.sto")
    assert for_opensim["shank_reaction_force_z"] == pytest.approx(table["shank_reaction_force_z"])
    assert {"floor-foot_force_z_q05", "thigh_reaction_moment_y_q95"} <= set(for_opensim)
    assert for_opensim["shank_reaction_force_z"].min() < -0.5 * table["floor-foot_force_z"].max() < 0
    assert run("plot", leg / "p.nc", "--out", leg / "again.png").exit_code == 0


def test_a_joint_and_an_actuator_of_one_name_have_columns_of_their_own(make_posterior, tmp_path):
    idata = make_posterior(1).assign_coords(joint=["cart"])
    idata.constant_data["turns"] = ("joint", [False])
    force = idata["posterior"]["torque"].rename(joint="actuator") + 100
    idata.posterior["actuator_force"] = force.assign_coords(actuator=["cart"])
    OutputFiles((tmp_path / "p.sto", tmp_path / "p.csv")).write(idata)
    for table, name in ((read_sto(tmp_path / "p.sto"), "cart_force"), (pd.read_csv(tmp_path / "p.csv"), "cart_torque")):
        np.testing.assert_allclose(table["cart_actuator_force"] - table[name], 100, rtol=1e-6)


def test_which_files_need_it(leg, tmp_path):
    assert reasons_for_engine(leg / "leg.xml") == ["contact of trunk, thigh, shank with the world"]
    arm = tmp_path / "arm.xml"
    arm.write_text(robot())
    assert reasons_for_engine(arm) == []
    tied = robot().replace("</worldbody>", '</worldbody><equality><joint joint1="elbow" joint2="shoulder"/></equality>')
    arm.write_text(tied)
    assert reasons_for_engine(arm) == ["1 equality constraint"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--set", "engine=bullet"), "--set engine: expected auto, mujoco, own, got 'bullet'"),
        (("--set", "drive=legs"), "expected a drive among auto, joints, actuators, wrench:BODY, got 'legs'"),
        (("--set", "drive=actuators"), "expected a file with actuators, got none"),
        (("--method", "svi"), "expected a method among smc, bootstrap, laplace, particle-gibbs for MuJoCo's"),
        (("--learn", "lengths"), "--learn: has no part in MuJoCo's engine"),
        (("--set", f"forces={__file__}"), "error: --set forces: has no part in MuJoCo's engine"),
    ],
)
def test_what_has_no_part_in_it_is_refused(leg, run, options, message):
    outcome = run("infer", leg / "leg.csv", "--body", leg / "leg.xml", *options, "--out", leg / "p.nc")
    assert outcome.exit_code == 2
    assert message in " ".join(outcome.output.split())
    assert not (leg / "p.nc").exists()


def test_a_file_that_mujoco_refuses_is_one_line(leg, run):
    (leg / "leg.xml").write_text((leg / "leg.xml").read_text().replace('pos="0 0 .55"', 'pos="0 0 .4"'))
    outcome = run("infer", leg / "leg.csv", "--body", leg / "leg.xml", "--set", "engine=mujoco", "--out", leg / "p.nc")
    assert outcome.exit_code == 2
    assert outcome.output.startswith(f"error: {leg / 'leg.xml'}: foot starts 0.125 m inside floor: move the body")
    assert "warning" not in outcome.output


def test_a_keypoint_that_the_file_does_not_have(leg, run):
    text = (leg / "leg.csv").read_text().replace("knee", "ankle")
    (leg / "leg.csv").write_text(text)
    outcome = run("infer", leg / "leg.csv", "--body", leg / "leg.xml", "--out", leg / "p.nc")
    assert outcome.exit_code == 2
    assert "keypoint 'ankle' is no site of leg, which has back, hip, knee, foot" in " ".join(outcome.output.split())
