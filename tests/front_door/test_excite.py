"""`invdyn excite`: the files that it leaves, what it prints, and what it refuses."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.recordings.logs.lerobot import read_lerobot

LIMITS = """[all]
speed = 2.0
[shoulder]
position = [-2.5, -0.6]
[elbow]
position = [-1.0, 1.0]
"""
QUICK = ("--seconds", "4", "--set", "starts=1")


@pytest.fixture
def limits(tmp_path):
    path = tmp_path / "limits.toml"
    path.write_text(LIMITS)
    return path


def excite(*arguments):
    return CliRunner().invoke(app, ["excite", "dfki_design_a0", *map(str, arguments)])


def test_one_motion_in_every_form(tmp_path, limits):
    pytest.importorskip("pyarrow")
    names = ("motion.csv", "motion.yaml", "motion.parquet", "tells.json", "motion.png")
    files = [tmp_path / name for name in names]
    outs = [word for file in files for word in ("--out", file)]
    result = excite("--limits", limits, *QUICK, *outs)
    assert result.exit_code == 0, result.output
    assert "4 s of shoulder, elbow, from rest to rest" in result.output
    assert "coulomb_friction, torque, ± N·m: shoulder" in result.output
    table = np.genfromtxt(files[0], delimiter=",", names=True)
    assert table["shoulder_angle"].min() > -2.5
    assert np.abs(table["elbow_velocity"]).max() < 2.1
    message = json.loads(files[1].read_text())  # JSON is YAML
    assert message["joint_names"] == ["shoulder", "elbow"]
    assert message["points"][-1]["time_from_start"] == {"sec": 4, "nanosec": 0}
    positions = np.array([point["positions"] for point in message["points"]])
    np.testing.assert_allclose(positions[:, 0], table["shoulder_angle"])
    (episode,) = read_lerobot(files[2])
    np.testing.assert_allclose(episode["action.1"].values, table["elbow_angle"], atol=1e-6)
    tells = json.loads(files[3].read_text())
    assert tells["nats"] > tells["random_motion_nats"]
    assert files[4].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--about", "gravity_tilt"), "expected effects among viscous_friction"),
        (("--joints", "knee"), "unknown joint 'knee'"),
        (("--seconds", "1"), "expected a motion of 2 to 3,600 s, got 1"),
    ],
)
def test_wrong_requests_are_one_line(tmp_path, limits, arguments, words):
    result = excite("--limits", limits, *arguments, "--out", tmp_path / "m.csv")
    assert result.exit_code == 2
    assert words in result.output
    assert not (tmp_path / "m.csv").exists()


def test_a_robot_without_ranges_wants_limits(tmp_path):
    result = excite("--out", tmp_path / "m.csv")
    assert result.exit_code == 2
    assert "joint 'shoulder' has no range: give one in a table of limits" in result.output
    result = excite("--out", tmp_path / "m.txt")
    assert "an output ends in .csv or .yaml" in result.output
