"""A person in place of a body file, on the command line."""

import shlex

import numpy as np
import pytest
from pages import ROOT, commands

from invdyn.inference import load_posterior
from invdyn.models import Link, person, planar_body
from invdyn.recordings import Recording, write_keypoint_csv
from invdyn.simulate import random_arm, record


@pytest.fixture
def recording(tmp_path):
    """Of a person of 1.75 m whose arm is 3 % longer than the table's."""
    links = [
        Link(each.name, each.joint.name, each.tip, 1.03 * each.nominal("length"), each.mass, each.com, each.inertia)
        for each in person(1.75, 70.0, "m").links
    ]
    arm = random_arm(planar_body("arm", links), duration=1.0, noise=0.002, seed=1)
    write_keypoint_csv(record(arm, 1, "curl")[0], tmp_path / "curl.csv")
    return tmp_path / "curl.csv"


def test_markers_have_the_names_of_the_file(tmp_path, monkeypatch, run, quick_inference):
    monkeypatch.chdir(tmp_path)
    points = np.cumsum(np.full((4, 3, 2), [0.2, 0.0]), axis=1)  # shoulder, elbow and wrist, .2 m apart
    points += 0.001 * np.random.default_rng(0).normal(size=points.shape)
    write_keypoint_csv(Recording(np.arange(4) / 100, points, ("RSHO", "RELB", "RWRA")), "markers.csv")
    line = [
        "infer",
        "markers.csv",
        "--height",
        "1.75",
        "--mass",
        "70",
        "--sex",
        "f",
        "--set",
        "base=RSHO",
        "--out",
        "p.nc",
    ]
    outcome = run(*line)
    assert outcome.exit_code == 2
    assert "rename one of them, of a person by --set keypoints=NAME" in " ".join(outcome.output.split())
    outcome = run(*line, "--set", "keypoints=RELB, RWRA")
    assert outcome.exit_code == 0, outcome.output
    assert quick_inference[0]["body"] == person(1.75, 70.0, "f", keypoints=("RELB", "RWRA"))
    assert quick_inference[0]["recording"].keypoint_names == ("shoulder", "RELB", "RWRA")


@pytest.mark.long
def test_height_mass_and_sex_stand_for_a_body(recording, tmp_path, run):
    out = tmp_path / "curl.nc"
    given = ["--height", 1.75, "--mass", 70, "--sex", "m", "--method", "laplace", "--filters", 4, "--out", out]
    outcome = run("infer", recording, *given)
    assert outcome.exit_code == 0, outcome.output
    posterior = load_posterior(out)
    assert posterior.attrs["body"] == "arm of a person of 1.75 m and 70 kg (m)"
    table = np.array([link.nominal("length") for link in person(1.75, 70.0, "m").links])
    found = posterior["posterior"]["length"].values.reshape(-1, 2)
    np.testing.assert_allclose(found, np.broadcast_to(1.03 * table, found.shape), rtol=0.01)
    assert posterior["posterior"]["mass"].values.std() > 0  # it is not known


def test_the_guides_command_runs(recording, tmp_path, monkeypatch, run, quick_inference):
    monkeypatch.chdir(tmp_path)
    (line,) = commands(ROOT / "docs" / "how-to" / "masses.md")
    outcome = run(*shlex.split(line)[1:], "--set", "payload=1.5")
    assert outcome.exit_code == 0, outcome.output
    assert quick_inference[0]["body"] == person(1.75, 70.0, "f", load=1.5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--height", 1.75, "--mass", 70], "missing: --body, or --sex"),
        ([], "missing: --body, or --height, --mass, --sex"),
        (["--body", "paper_planar_arm", "--sex", "f"], "--body and --sex: leave one of them out"),
        (["--body", "paper_planar_arm", "--set", "keypoints=a,b"], "keypoints are a person's"),
        (
            ["--height", 1.75, "--mass", 70, "--sex", "f", "--set", "keypoints=a"],
            "expected 2 keypoints, as elbow, wrist",
        ),
        (["--height", 175, "--mass", 70, "--sex", "f"], "height from 0.4 to 2.8 m, got 175"),
    ],
)
def test_half_a_person_is_refused(recording, tmp_path, run, given, message):
    outcome = run("infer", recording, *given, "--out", tmp_path / "p.nc")
    assert outcome.exit_code == 2
    assert message in " ".join(outcome.output.split())
