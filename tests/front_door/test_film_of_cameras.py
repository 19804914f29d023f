"""`invdyn infer` straight from the pixels of several cameras, and one line for any mistake."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import ring

from invdyn.inference import load_posterior
from invdyn.models import ArmModel, Body, Joint, Keypoints, Link, Observation
from invdyn.recordings import Recording, write_keypoint_csv
from invdyn.recordings.cameras import project, write_calibration

CAMERAS = ring(3)
FRAMES, RATE = 16, 30.0
PLANAR = 'name = "arm"\n[[links]]\nname = "rod"\njoint = "pivot"\ntip = "tip"\nlength = 0.4\nmass = 1.0\n'


def rod(length=0.4):
    ball = (0.01, 0.01, 0.01, 0.0, 0.0, 0.0)
    hanging = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
    link = Link(
        "rod",
        Joint("pivot", "universal"),
        origin=(0.0, 0.0, 1.0),
        rotation=hanging,
        mass=1.0,
        com=(length / 2, 0.0, 0.0),
        inertia=ball,
        sites={"middle": (length / 2, 0.0, 0.0), "tip": (length, 0.0, 0.0)},
    )
    return Body("rod", [link])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Tracks of three cameras with what lasts, and a keypoint that is in one camera alone; body, calibrations."""
    folder = tmp_path_factory.mktemp("film")
    time = np.arange(FRAMES) / RATE
    own = {"torque.scale": 1.0, "initial.angle": [0.5, 0.2], "initial.angle_scale": 0.1, "initial.velocity_scale": 1.0}
    torch.manual_seed(0)
    model = ArmModel(rod(), time, Observation(Keypoints([0, 1])), parameters=own)
    states, _ = model.simulate()
    points = model.dynamics.keypoints(model.split(states)[1], model.body_parameters()).numpy()
    rng = np.random.default_rng(0)
    for camera in CAMERAS:
        pixels = project(camera, points) + rng.standard_normal((FRAMES, 2, 2)) + 3 * rng.standard_normal((2, 2))
        if camera.name != "cam2":
            pixels[6:9, 1] = np.nan
        # One keypoint more than the body has.
        pixels = np.concatenate([pixels[:, ::-1], pixels[:, :1] + 50], 1)
        track = Recording(time, pixels, ("tip", "middle", "nose"), rng.uniform(0.5, 1, (FRAMES, 3)))
        write_keypoint_csv(track, folder / f"{camera.name}.csv")
    write_keypoint_csv(Recording(time, pixels, ("a", "b", "c")), folder / "strange.csv")
    write_keypoint_csv(Recording(time[1:], pixels[1:], ("tip", "middle", "nose")), folder / "short.csv")
    write_calibration(CAMERAS, folder / "calibration.toml")
    write_calibration(CAMERAS.scaled(1000.0), folder / "thousand.toml")
    write_calibration(CAMERAS.scaled(3.0, metric=False), folder / "unknown.toml")
    rod().to_toml(folder / "rod.toml")
    rod(0.25).to_toml(folder / "short.toml")
    crossed = replace(rod(), links=[replace(rod().links[0], sites={"tip": (0.2, 0.0, 0.0), "middle": (0.4, 0.0, 0.0)})])
    crossed.to_toml(folder / "crossed.toml")
    (folder / "planar.toml").write_text(PLANAR)
    other = rod()
    replace(other, links=[replace(other.links[0], sites={"hand": (0.4, 0.0, 0.0)})]).to_toml(folder / "hand.toml")
    return folder


@pytest.fixture(autouse=True)
def here(folder, monkeypatch):
    monkeypatch.chdir(folder)


TRACKS = ("cam1.csv", "cam2.csv", "cam3.csv")
CALL = ("--calibration", "calibration.toml", "--body", "rod.toml", "--out", "posterior.nc")


@pytest.mark.long
def test_infer(folder, run):
    outcome = run("infer", *TRACKS, *CALL, "--method", "laplace", "--out", "torques.csv", "--frames", "0:14")
    assert outcome.exit_code == 0, outcome.output
    idata = load_posterior(folder / "posterior.nc")
    seen = idata["observed_data"]["pixel"]
    assert seen.dims == ("time", "camera", "keypoint", "picture")
    assert seen.attrs["units"] == "px"
    assert seen["camera"].values.tolist() == ["cam1", "cam2", "cam3"]
    assert seen["keypoint"].values.tolist() == ["middle", "tip"]
    assert seen.sizes["time"] == 14
    predicted = idata["posterior_predictive"]["pixel"]
    off = (seen - predicted.mean(("chain", "draw"))).values
    assert np.nanmedian(np.abs(off)) < 3  # px, noise of 1
    assert idata["posterior"]["position"].attrs["units"] == "m"
    assert (folder / "torques.csv").exists()


def test_diagnose(folder, run, monkeypatch):
    """Of the points that are triangulated, with too few rows for a search."""
    outcome = run("diagnose", *TRACKS, *CALL[:-1], "report", "--zero-torque")
    assert outcome.exit_code == 0, outcome.output
    assert "Not enough data" in outcome.stdout
    assert (folder / "report" / "report.html").exists()


BAD = {
    "no calibration": (("infer", *TRACKS, "--body", "planar.toml", *CALL[4:]), "expected one recording, got 3"),
    "one camera": (("infer", "cam1.csv", *CALL), "two cameras or more"),
    "no file": (("infer", "cam1.csv", "cam2=none.csv", *CALL), "none.csv"),
    "another camera": (("infer", "cam1.csv", "cam9=cam2.csv", *CALL), "no camera 'cam9'"),
    "other names": (("infer", "cam1.csv", "cam2=strange.csv", *CALL), "is not in the tracks of both"),
    "other rows": (("infer", "cam1.csv", "cam2=short.csv", *CALL), "has 15 rows"),
    "no keypoint of the body": (
        ("infer", *TRACKS, *CALL[:2], "--body", "hand.toml", *CALL[4:]),
        "no keypoint of the body is in the tracks",
    ),
    "a body in the plane": (("infer", *TRACKS, *CALL[:2], "--body", "planar.toml", *CALL[4:]), "dimensions = 3"),
    "no body": (("infer", *TRACKS, *CALL[:2], "--body", "none.toml", *CALL[4:]), "none.toml"),
    "not metric": (("infer", *TRACKS, "--calibration", "unknown.toml", *CALL[2:]), "--calibration-out"),
    "not metres": (("infer", *TRACKS, "--calibration", "thousand.toml", *CALL[2:]), "is the calibration in metres"),
    "names that are exchanged": (
        ("compare", *TRACKS, *CALL[:2], "--body", "crossed.toml", "--methods", "laplace", "--out", "compared"),
        "seem to be exchanged: distances differ",
    ),
    "another length": (
        ("infer", *TRACKS, *CALL[:2], "--body", "short.toml", *CALL[4:]),
        "m apart (median), but the body's link is 0.125 m long",
    ),
    "units of metres": (("infer", *TRACKS, *CALL, "--units", "mm"), "leave --units out"),
    "lengths to learn": (("infer", *TRACKS, *CALL, "--learn", "lengths"), "{start = 0.3}"),
    "a base": (("infer", *TRACKS, *CALL, "--set", "base=tip"), "leave --set base out"),
    "an offset in words": (("infer", *TRACKS, *CALL, "--set", "offset=cam2=late"), "CAMERA=SECONDS"),
    "an offset of no camera": (("infer", *TRACKS, *CALL, "--set", "offset=cam9=1"), "cam9"),
    "an unknown part of a camera": (("infer", *TRACKS, *CALL, "--learn", "lens"), "offset, pose, turn"),
    "cameras of no film": (
        ("infer", "cam1.csv", "--body", "planar.toml", "--out", "p.nc", "--learn", "pose"),
        "--learn pose needs several cameras",
    ),
    "an offset of no film": (
        ("infer", "cam1.csv", "--body", "planar.toml", "--out", "p.nc", "--set", "offset=cam2=0"),
        "leave --set offset out, which is for tracks of several cameras",
    ),
    "too few rows": (("infer", *TRACKS, *CALL, "--frames", "3:4"), "at least 2 frames"),
    "over the tracks": (("infer", *TRACKS, *CALL[:-1], "cam1.csv"), "overwrite"),
    "over the calibration": (("infer", *TRACKS, *CALL[:-1], "calibration.toml"), "overwrite"),
    "a diagnosis with a log": (
        ("diagnose", *TRACKS, *CALL[:-1], "report", "--held-out", "more.csv"),
        "`invdyn triangulate` makes them",
    ),
    "a diagnosis of one camera": (("diagnose", "cam1.csv", *CALL[:-1], "report"), "two or more"),
    "a diagnosis over its tracks": (("diagnose", *TRACKS, *CALL[:-1], "cam1.csv"), "cam1.csv"),
    "a diagnosis without calibration": (("diagnose", *TRACKS, *CALL[2:-1], "report"), "expected one recording, got 3"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(case, folder, run):
    call, said = BAD[case]
    before = sorted(folder.iterdir())
    outcome = run(*call)
    assert outcome.exit_code == 2, outcome.output
    assert said in outcome.stderr
    assert outcome.stderr.strip().count("\n") == 0
    assert sorted(folder.iterdir()) == before
