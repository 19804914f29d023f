"""`invdyn diagnose` takes MuJoCo's engine where the body's file and the log need it, and says why."""

import json
from dataclasses import replace

import linkages
import mujoco
import numpy as np
import pytest

from invdyn.diagnosis_options import Diagnosed
from invdyn.engine_input import engine_log_of
from invdyn.models import Scene
from invdyn.models.engine.needed import touched
from invdyn.recordings import write_keypoint_csv


@pytest.fixture
def gripper(tmp_path):
    """A gripper with a stiffer tendon than its file says, and its log."""
    (tmp_path / "gripper.xml").write_text(linkages.HOLDING)
    model = mujoco.MjModel.from_xml_string(linkages.HOLDING)
    model.tendon_stiffness[0] *= 1.5
    write_keypoint_csv(linkages.log_of(model, linkages.grasp, rows=60), tmp_path / "log.csv")
    write_keypoint_csv(linkages.log_of(model, linkages.grasp, rows=30, seed=1), tmp_path / "other.csv")
    return tmp_path


@pytest.mark.long
def test_from_a_log_to_a_corrected_file(gripper, run):
    outcome = run("diagnose", gripper / "log.csv", "--body", gripper / "gripper.xml", "--max-effects", "1", "--out",
                  gripper / "found", "--write-back", gripper / "better.xml", "--held-out", gripper / "other.csv",
                  "--ensemble", "3", gripper / "copies")  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    said = " ".join(outcome.output.split())
    assert "dynamics by MuJoCo's own step: 1 equality constraint; tendons pull" in said
    assert "There is a gap: the simulation leaves out tendon stiffness of the pull" in said
    found = json.loads((gripper / "found" / "diagnosis.json").read_text())
    assert "another recording" in (gripper / "found" / "report.html").read_text()
    assert "Not looked at: signs, zeros" in said
    ranges = json.loads((gripper / "copies" / "randomisation.json").read_text())
    assert [(each["place"], each["quantity"]) for each in ranges["numbers"]] == [("pull", "tendon stiffness")]
    assert ranges["mjx"][0]["field"] == "tendon_stiffness"
    assert found["causes"][0]["effects"][0]["tendon"] == "pull"
    assert float(mujoco.MjModel.from_xml_path(str(gripper / "better.xml")).tendon_stiffness[0]) == pytest.approx(
        90.0, rel=0.02
    )
    assert "tendon stiffness of the pull" in (gripper / "found" / "report.html").read_text().lower()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--estimate", "damping"), "--estimate: has no part in MuJoCo's engine"),
        (("--budget", "5"), "--budget: has no part in MuJoCo's engine"),
        (("--set", "engine=bullet"), "--set engine: expected auto, mujoco, own, got 'bullet'"),
        (("--workers", "7"), "--workers: has no part in MuJoCo's engine"),
    ],
)
def test_what_has_no_part_in_it_is_refused(gripper, run, options, message):
    outcome = run("diagnose", gripper / "log.csv", "--body", gripper / "gripper.xml", *options, "--out", gripper / "f")
    assert outcome.exit_code == 2
    assert message in " ".join(outcome.output.split())


def test_too_short_a_log_is_an_answer(gripper, run):
    header, *rows = (gripper / "log.csv").read_text().splitlines()
    (gripper / "short.csv").write_text("\n".join([header, *rows[:10]]))
    outcome = run("diagnose", gripper / "short.csv", "--body", gripper / "gripper.xml", "--out", gripper / "found")
    assert outcome.exit_code == 0, outcome.output
    assert "Not enough data" in outcome.output


@pytest.mark.parametrize(("logged", "taken"), [(("left", "right", "lift"), True), (("lift",), False)])
def test_a_tendon_that_no_encoder_shows_leaves_the_fast_engine(gripper, logged, taken):
    """Of an arm's log without its gripper."""
    model = mujoco.MjModel.from_xml_string(linkages.HOLDING)
    recording = linkages.log_of(model, linkages.grasp, rows=30)
    own = [recording.joint_names.index(name) for name in (*logged, "pulled")]
    kept = replace(recording, angles=recording.angles[:, own], torques=recording.torques[:, own],
                   joint_names=tuple(recording.joint_names[k] for k in own))  # fmt: skip
    write_keypoint_csv(kept, gripper / "log.csv")
    given = Diagnosed(recordings=[str(gripper / "log.csv")], body=gripper / "gripper.xml")
    assert (engine_log_of(given, "auto") is not None) == taken


def test_an_arm_over_a_floor_that_it_does_not_touch():
    text = """<mujoco><worldbody><geom type="plane" size="2 2 .1"/><body pos="0 0 .5"><joint name="arm" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .45" size=".02"/></body></worldbody></mujoco>"""
    scene = Scene.of(text)
    low, high = np.linspace(0, 1, 5)[:, None], np.linspace(0, np.pi, 5)[:, None]
    assert not touched(scene, low, ("arm",))
    assert touched(scene, np.array([[0.0], [np.nan], [np.pi]]) * 0.9 + 0.3, ("arm",)) is False
    deeper = text.replace("0 0 .45", "0 0 .49")
    assert touched(Scene.of(deeper), high, ("arm",))
    assert not touched(scene, None, ())
