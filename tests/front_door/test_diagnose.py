"""`invdyn diagnose`: what it is given, what it writes and says; bad input leaves everything as it was."""

import json
import re
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from robot_log import ARM, robot_log

from invdyn.diagnosis.assessment.posture import posture
from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Estimate, Finding, Gap, Outside, Shrinkage, Where
from invdyn.diagnosis.report import write_report
from invdyn.recordings import InputError, write_keypoint_csv

DIAGNOSE = ("diagnose", "rec.csv", "--body", "arm.toml", "--out", "found")
COMMANDED = "time,shoulder_x,shoulder_y,elbow_x,elbow_y,wrist_x,wrist_y,shoulder_torque,elbow_torque\n"


def found(recording, body, seed, not_enough=None):
    """Viscous friction of the elbow, or too little to say."""
    damping = {"damping": Estimate(0.3, 0.01, (0.28, 0.32), "N·m·s/rad")}
    cause = Cause((Finding("viscous_friction", "dynamics", {"joint": "elbow"}, damping),), 0.97, 10.0, 0.1)
    return Diagnosis(
        recording=recording.name,
        body=body.name,
        seed=seed,
        regime="unknown_torque" if recording.torques is None else "commanded",
        gap=Gap(not_enough is None, 0.99, {}, {}, {}),
        where=Where({"dynamics": 0.98, "observation": 0.02}, {"shoulder": 0.1, "elbow": 0.9}, {}, (), ()),
        causes=() if not_enough else (cause,),
        ambiguity_set=(),
        separating_experiment=None,
        outside=Outside(0.01),
        not_identifiable=(),
        shrinkage=Shrinkage(0.96, (0.93, 0.99), True, {}),
        joint_names=body.joint_names,
        link_names=tuple(link.name for link in body.links),
        posture=posture(body),
        tracks=None,
        screened=(),
        visibility=(),
        method={},
        not_enough_data=not_enough,
    )


@pytest.fixture
def calls(monkeypatch):
    """Instead of a diagnosis, a finding at once; what it was called with."""
    calls = []
    fake = ModuleType("invdyn.diagnosis.diagnose")

    def diagnose(recording, body, *, seed=0, progress=None, **options):
        calls.append({"recording": recording, "body": body, "seed": seed, **options})
        progress(1, 2, "causes")
        recording = recording[0] if isinstance(recording, list) else recording
        if recording.name == "interrupt":
            raise KeyboardInterrupt
        if recording.num_frames == 2:
            raise InputError("rec.csv: the recording does not fit")
        return found(recording, body, seed, "6 rows, a diagnosis needs 20" if recording.num_frames < 10 else None)

    def save(diagnosis, folder, *, workers):
        assert workers == calls[-1]["workers"]
        Path(folder, "diagnosis.json").write_text(json.dumps(diagnosis.to_json()))
        write_report(diagnosis, Path(folder, "report.html"))

    fake.diagnose = diagnose
    monkeypatch.setitem(sys.modules, fake.__name__, fake)
    monkeypatch.setattr("invdyn.diagnosis.report.save.save", save)
    return calls


@pytest.fixture
def commanded(folder):
    """A recording with the base tracked, off the origin, and commands."""
    rows = [f"{0.03 * t:.2f},.1,.2,1.1,.2,2.1,.2,1,2\n" for t in range(12)]
    (folder / "run.csv").write_text(COMMANDED + "".join(rows))
    body = (folder / "arm.toml").read_text().replace('name = "arm"\n', 'name = "arm"\nbase = [0.1, 0.2]\n', 1)
    (folder / "bench.toml").write_text(body)
    return ("diagnose", "run.csv", "--body", "bench.toml", "--out", "found")


def test_help(run):
    for command in ("diagnose", "blind"):
        outcome = run(command, "--help")
        assert outcome.exit_code == 0
        assert "--out" in outcome.stdout
        assert command in run("--help").stdout


def test_what_is_written_and_said(folder, run, calls):
    outcome = run(*DIAGNOSE, "--seed", 7)
    assert outcome.exit_code == 0, outcome.output
    assert {path.name for path in (folder / "found").iterdir()} == {"diagnosis.json", "report.html"}
    written = json.loads((folder / "found/diagnosis.json").read_text())
    assert (written["seed"], written["causes"][0]["effects"][0]["effect"]) == (7, "viscous_friction")
    first, *_ = outcome.stdout.splitlines()
    assert first.startswith("There is a gap: the simulation leaves out viscous friction at the elbow")
    assert "found/report.html" in outcome.stdout
    assert calls[0]["held_out"] is None
    assert calls[0]["passive"] is False
    assert calls[0]["without"] == ()


def test_options_arrive(commanded, folder, run, calls):
    (folder / "other.csv").write_text((folder / "run.csv").read_text())
    outcome = run(*commanded, "--held-out", "other.csv", "--exclude", "payload, armature", "--frames", "1:11")
    assert outcome.exit_code == 0, outcome.output
    (call,) = calls
    assert call["without"] == ("payload", "armature")
    assert call["recording"].num_frames == 10
    assert call["held_out"].num_frames == 12
    assert call["recording"].torques[0].tolist() == [1, 2]
    assert call["most"] == 4
    assert (call["budget"], call["tolerance"], call["robot"]) == (None, None, False)
    assert call["checkpoint"] is None
    run(
        *commanded,
        "--zero-torque",
        "--max-effects",
        "6",
        "--budget",
        "600",
        "--set",
        "tolerance=0.02",
        "--checkpoint",
        "kept",
    )
    assert calls[-1]["checkpoint"] == Path("kept")
    assert (calls[-1]["budget"], calls[-1]["tolerance"]) == (600.0, 0.02)
    assert calls[-1]["passive"] is True
    assert calls[-1]["most"] == 6
    run(*commanded, "--set", "source=robot")
    assert calls[-1]["robot"] is True
    assert "expected a source among robot, simulation" in run(*commanded, "--set", "source=real").output
    run(*commanded, "--set", "hide_torque=yes", "--held-out", "other.csv")
    assert calls[-1]["recording"].torques is None
    assert calls[-1]["held_out"].torques is None


def test_keypoints_stay_where_they_were_filmed(commanded, run, calls):
    """A shaking base, or a camera that is not level, would not show in differences to the base."""
    run(*commanded)
    assert calls[-1]["recording"].keypoint_names == ("elbow", "wrist")
    np.testing.assert_allclose(calls[-1]["recording"].keypoints[0], [[1.1, 0.2], [2.1, 0.2]])
    run(*commanded[:2], "--body", "arm.toml", "--out", "found", "--set", "base=shoulder")
    np.testing.assert_allclose(calls[-1]["recording"].keypoints[0], [[1.0, 0.0], [2.0, 0.0]])


def test_a_camera_and_a_log(folder, run, calls):
    """Its clock is found from the motion and said, or stated; the two are one recording."""
    both = robot_log(5)
    ARM.to_toml(folder / "robot.toml")
    seen = np.isfinite(both.keypoints).all((1, 2))
    film = replace(both.at(seen), angles=None, torques=None, joint_names=())
    write_keypoint_csv(replace(film, time=film.time + 2.5), folder / "film.csv")
    write_keypoint_csv(replace(both, keypoints=both.keypoints[:, :0], keypoint_names=()), folder / "log.csv")
    given = ("diagnose", "log.csv", "--body", "robot.toml", "--out", "found", "--camera", "film.csv")
    outcome = run(*given)
    assert outcome.exit_code == 0, outcome.stderr
    said = re.search(r"clock      film is ahead of log by (\S+) ± (\S+) s", outcome.stdout)
    assert abs(float(said[1]) - 2.5) < 0.002
    assert run(*given, "--set", "clock=2.5").exit_code == 0
    for call in calls:
        recording = call["recording"]
        assert recording.keypoint_names == both.keypoint_names
        assert np.isfinite(recording.keypoints).all((1, 2)).sum() == seen.sum()
    assert calls[1]["recording"].num_frames == both.num_frames
    refused = run("diagnose", "log.csv", "--body", "robot.toml", "--out", "found", "--set", "clock=2.5")
    assert refused.exit_code == 2
    assert "name its keypoints with --camera" in refused.stderr


def test_not_enough_data_is_an_answer(folder, run, calls):
    outcome = run(*DIAGNOSE, "--frames", ":6")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.startswith("Not enough data to say whether there is a gap: 6 rows")
    assert json.loads((folder / "found/diagnosis.json").read_text())["not_enough_data"]


def test_a_body_in_mjcf(folder, run, calls):
    pytest.importorskip("mujoco")
    (folder / "arm.xml").write_text(
        """<mujoco><worldbody><body name="upper_arm"><joint name="shoulder" axis="0 0 1" range="-9 9" limited="true"/>
        <inertial pos="0.5 0 0" mass="0.5" diaginertia=".04 .04 .04"/>
        <body name="forearm" pos="1 0 0"><joint name="elbow" axis="0 0 1"/>
        <inertial pos="0.5 0 0" mass="0.3" diaginertia=".02 .02 .02"/>
        <site name="wrist" pos="1 0 0"/></body></body></worldbody></mujoco>"""
    )
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        outcome = run("diagnose", "rec.csv", "--body", "arm.xml", "--out", "found")
    assert outcome.exit_code == 0, outcome.output
    assert "warning: arm.xml: a rigid body leaves out limits (shoulder)" in outcome.stderr
    assert calls[0]["body"].keypoint_names == ("elbow", "wrist")
    assert [link.nominal("mass") for link in calls[0]["body"].links] == pytest.approx([0.5, 0.3])


def test_numbers_of_the_file_are_freed(folder, run, calls):
    text = (folder / "arm.toml").read_text().replace('tip = "wrist"', 'tip = "wrist"\ndamping = 0.1\narmature = 0.02')
    (folder / "arm.toml").write_text(text)
    outcome = run(*DIAGNOSE, "--estimate", "damping,armature.elbow=0.5, mass=0.05")
    assert outcome.exit_code == 0, outcome.output
    stated = {
        key: sd for key, sd in calls[0]["body"].uncertainty.items() if key in ("damping", "armature.elbow", "mass")
    }
    assert stated == {"damping": 0.3, "armature.elbow": 0.5, "mass": 0.05}
    outcome = run(*DIAGNOSE, "--estimate", "armature.shoulder")
    assert outcome.exit_code == 2
    assert "no armature at shoulder that could be learned" in outcome.stderr


MAP = """
time = "t"
time_unit = "s"
[joints.shoulder]
angle = {track = "s", unit = "rad"}
torque = {track = "s_tau"}
[joints.elbow]
angle = {track = "e", unit = "rad"}
torque = {track = "e_tau"}
"""


def test_several_logs_with_one_map_are_recordings_of_one_arm(folder, run, calls):
    """As those of --with are, which come after them; without a map they may be of several cameras."""
    rows = [f"{0.03 * t:.2f},{0.1 * t},.2,1,2\n" for t in range(12)]
    for name in "abc":
        (folder / f"{name}.csv").write_text("t,s,e,s_tau,e_tau\n" + "".join(rows))
    (folder / "map.toml").write_text(MAP)
    outcome = run("diagnose", "a.csv", "b.csv", "--with", "c.csv", "--map", "map.toml", "--force", *DIAGNOSE[2:])
    assert outcome.exit_code == 0, outcome.output
    assert [Path(each.name).stem for each in calls[0]["recording"]] == ["a", "b", "c"]
    outcome = run("diagnose", "a.csv", "b.csv", "./a.csv", "--map", "map.toml", *DIAGNOSE[2:])
    assert "a.csv: expected another recording of the same arm" in outcome.stderr


def test_an_ensemble_makes_its_folder(folder, run, calls):
    outcome = run(*DIAGNOSE, "--ensemble", "3", "copies/of/arm")
    assert outcome.exit_code == 0, outcome.output
    assert len(list((folder / "copies/of/arm").glob("robot_*.toml"))) == 3


BAD = {
    "no recording": (("diagnose", "none.csv", *DIAGNOSE[2:]), "none.csv"),
    "no body": ((*DIAGNOSE[:3], "none.toml", *DIAGNOSE[4:]), "none.toml"),
    "output is a file": ((*DIAGNOSE[:-1], "hand.csv"), "expected a folder"),
    "no held-out recording": ((*DIAGNOSE, "--held-out", "none.csv"), "none.csv"),
    "held out is of another body": ((*DIAGNOSE, "--held-out", "hand.csv"), "velocity"),
    "unknown effect": ((*DIAGNOSE, "--exclude", "magic"), "viscous_friction"),
    "free of an unknown kind": ((*DIAGNOSE, "--estimate", "dampng"), "did you mean 'damping'"),
    "free without a number": ((*DIAGNOSE, "--estimate", "mass=much"), "mass=0.5, got 'much'"),
    "free of nothing": ((*DIAGNOSE, "--estimate", "damping"), "has no damping at any joint"),
    "zero and hidden": ((*DIAGNOSE, "--zero-torque", "--set", "hide_torque=yes"), "choose one"),
    "held out is the recording": ((*DIAGNOSE, "--held-out", "./rec.csv"), "rec.csv: expected another recording"),
    "a recording twice": ((*DIAGNOSE, "--with", "hand.csv,hand.csv"), "for --with, got one twice"),
    "frames in words": ((*DIAGNOSE, "--frames", "all"), "50:250"),
    "one frame": ((*DIAGNOSE, "--frames", "3:4"), "2 frames"),
    "does not fit": ((*DIAGNOSE, "--frames", "3:5"), "does not fit"),
    "no output": (DIAGNOSE[:-2], "--out"),
    "a copy of no file": (
        (
            "diagnose",
            "rec.csv",
            "--height",
            "1.8",
            "--mass",
            "80",
            "--sex",
            "m",
            "--out",
            "found",
            "--write-back",
            "a.xml",
        ),
        "correct copies of a file: give --body",
    ),
    "a copy of another kind": ((*DIAGNOSE, "--write-back", "new.urdf"), "new.urdf"),
    "a broken MJCF": (("diagnose", "rec.csv", "--body", "bad.xml", "--out", "found"), "bad.xml"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD.values(), ids=BAD.keys())
def test_bad_input_is_one_line_and_leaves_all_as_it_was(folder, run, contents, calls, arguments, named):
    (folder / "bad.xml").write_text("<mujoco>")
    before = contents(folder)
    outcome = run(*arguments)
    assert outcome.exit_code == 2, outcome.output
    assert not outcome.stdout
    (line,) = [line for line in outcome.stderr.splitlines() if "causes" not in line]
    assert line.startswith("error: ")
    assert named in line
    assert contents(folder) == before
    assert not (folder / "found").exists()


BODIES = {
    "other keypoints": ('tip = "wrist"', 'tip = "hand"', "wrist"),
    "other size": ("length = 1.0", "length = 0.1", "length"),
}


@pytest.mark.parametrize(("good", "bad", "named"), BODIES.values(), ids=BODIES.keys())
def test_a_body_that_does_not_fit(folder, run, calls, good, bad, named):
    text = (folder / "arm.toml").read_text()
    (folder / "arm.toml").write_text(text.replace(good, bad))
    outcome = run(*DIAGNOSE)
    assert outcome.exit_code == 2
    assert named in outcome.stderr
    assert not calls


def test_an_interrupt_writes_nothing(folder, run, calls):
    (folder / "interrupt.csv").write_text((folder / "rec.csv").read_text())
    outcome = run("diagnose", "interrupt.csv", *DIAGNOSE[2:])
    assert outcome.exit_code == 130
    assert not (folder / "found").exists()
