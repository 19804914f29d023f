"""Every command of the pages on films, cameras and the blind check runs as it stands, on files as the pages have them.

Only the work within is made small: a network learns for a few steps, a person is tracked by a stand-in, labels are set
at once, boards are not looked for, an inference is a posterior at once, and a blind run has no cases.
"""

import shlex
import stat
import webbrowser
from dataclasses import replace

import numpy as np
import pytest
from filmed import joints, stick, swinging
from pages import ROOT, commands
from scenes import ring
from scenes import swinging as moving

import invdyn.recordings.cameras as cameras
from invdyn.blindcheck.run import BlindRun
from invdyn.blindcheck.score import score
from invdyn.label_server import LabelServer
from invdyn.models import Body, Joint, Link
from invdyn.recordings import Recording, write_keypoint_csv
from invdyn.recordings.cameras import project, write_calibration
from invdyn.recordings.cameras.intrinsics import Intrinsics
from invdyn.recordings.tracking import blazepose, training


def run_all(run, page, monkeypatch, folder):
    """Run each command of a page in a folder; its first line that fails is reported."""
    monkeypatch.chdir(folder)
    lines = commands(ROOT / "docs" / page)
    assert lines
    for line in lines:
        outcome = run(*shlex.split(line, comments=True)[1:])
        assert outcome.exit_code == 0, f"{line}: {outcome.output}"
    return lines


class Person:
    """Stands in for the network that finds a person's arm."""

    keypoint_names, picture_size = ("shoulder", "elbow", "wrist"), (40, 40)

    def track(self, rgb):
        return np.array([[20.0, 12.0, 0.9], [20.0, 22.0, 0.9], [21.0, 31.0, 0.9]])


@pytest.mark.long
def test_films(tmp_path, monkeypatch, run, quick_inference):
    for name, frames in (("robot", 110), ("swing", 12), ("curl", 12)):
        swinging(tmp_path / "film.mov", frames)
        (tmp_path / "film.mov").rename(tmp_path / f"{name}.mp4")
    for name, scale in (("arm", 0.001),):  # metres a pixel, as the page has them
        (tmp_path / f"{name}.toml").write_text(stick(scale))

    def label(server):
        times = np.arange(110) / 30
        numbers = server.shared.numbers
        points = joints(times)[1][numbers].tolist()
        changes = [[i, p, point, 0] for i, row in enumerate(points) for p, point in enumerate(row)]
        assert server.take({"since": 0, "changes": changes})["refused"] == []

    monkeypatch.setattr(LabelServer, "serve_forever", label)
    monkeypatch.setattr(webbrowser, "open", lambda address: True)
    few = training.train
    monkeypatch.setattr(training, "train", lambda *given, **options: few(*given, **options | {"steps": 4}))
    monkeypatch.setattr(blazepose, "person_tracker", lambda arm, person, progress: Person())
    # what learned for four steps puts joints anywhere
    for module in ("table_input", "diagnosis.check.units"):
        monkeypatch.setattr(f"invdyn.{module}.check_fits", lambda *_: None)
    lines = run_all(run, "how-to/film.md", monkeypatch, tmp_path)
    assert len(quick_inference) == sum("invdyn infer" in line for line in lines)
    for made in ("curl_arm.mp4", "labels.csv", "robot.safetensors", "tracks.csv", "found/report.html"):
        assert (tmp_path / made).stat().st_size > 0, made


def test_cameras(tmp_path, monkeypatch, run, quick_inference):
    pytest.importorskip("cv2")
    both = ring(2)
    both = replace(both, cameras=tuple(replace(c, name=n) for c, n in zip(both, ("left", "right"), strict=True)))
    points = moving(30)
    for camera in both:
        track = Recording(np.arange(30) / 30, project(camera, points), ("shoulder", "elbow", "wrist"))
        write_keypoint_csv(track, tmp_path / f"{camera.name}.csv")
        (tmp_path / f"{camera.name}.mp4").write_bytes(b"")
    write_calibration(both.scaled(3.0, metric=False), tmp_path / "unknown.toml")
    ball, sites = (0.01, 0.01, 0.01, 0.0, 0.0, 0.0), {"elbow": (0.28, 0.0, 0.0), "wrist": (0.5, 0.0, 0.0)}
    hung = {"origin": (0.0, 0.0, 1.3), "mass": 1.0, "com": (0.1, 0.0, 0.0), "inertia": ball, "sites": sites}
    arm = Link("arm", Joint("shoulder", "universal"), **hung)
    Body("arm", [arm]).to_toml(tmp_path / "arm.toml")
    lenses = {c.name: Intrinsics(c.matrix, c.distortion, c.size, 0.2, np.array([1.5, 1.5]), 17) for c in both}
    found = replace(both, error=0.2), lenses
    monkeypatch.setattr(cameras, "calibrate", lambda sources, board, every, progress: found)
    run_all(run, "cameras.md", monkeypatch, tmp_path)
    assert len(quick_inference) == 1
    for made in ("calibration.toml", "arm.csv", "errors.csv", "posterior.nc"):
        assert (tmp_path / made).stat().st_size > 0, made


def test_the_blind_check(tmp_path, monkeypatch, run):
    pytest.importorskip("pinocchio")
    launched = []
    (tmp_path / "seed.txt").write_text("12345678901")
    (tmp_path / "my_method").write_text("#!/bin/sh\n")
    (tmp_path / "my_method").chmod(stat.S_IRWXU)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(BlindRun, "make", lambda self, progress: launched.append(self) or "0" * 64)
    monkeypatch.setattr(BlindRun, "diagnose", lambda self, progress: None)
    monkeypatch.setattr(BlindRun, "score", lambda self, progress, oracle: score({}, {}))
    lines = run_all(run, "blind_protocol.md", monkeypatch, tmp_path)
    assert len(launched) == len(lines)
    assert {each.engine for each in launched} == {"mujoco", "pinocchio", "mujoco-in-space"}
    assert sum(launched[0].counts.values()) == 200
    assert launched[-1].seed == 12345678901
