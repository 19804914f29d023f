"""`infer --torque none`: motion and lengths, and all outputs but forces."""

from pathlib import Path

import numpy as np
import pytest

from invdyn.inference import load_posterior
from invdyn.recordings import read_table

SMALL = ("--filters", 4, "--particles", 20, "--set", "draws=4")


@pytest.fixture
def swinging(folder):
    """rec.csv of an arm of .8 and .6 m that swings, off by 5 mm; arm.toml says 1 m each."""
    time, rng = np.arange(24) / 30, np.random.default_rng(0)
    upper = -1.5 + 0.5 * np.sin(4 * time)
    fore = upper + 0.4 + 0.6 * np.sin(5 * time)
    elbow = 0.8 * np.stack([np.cos(upper), np.sin(upper)], -1)
    wrist = elbow + 0.6 * np.stack([np.cos(fore), np.sin(fore)], -1)
    points = np.concatenate([elbow, wrist], -1) + 0.005 * rng.normal(size=(24, 4))
    lines = [",".join(f"{value:.6f}" for value in (t, *row)) for t, row in zip(time, points, strict=True)]
    Path("rec.csv").write_text("\n".join(["time,elbow_x,elbow_y,wrist_x,wrist_y", *lines]) + "\n")
    return folder


def test_it_writes_all_that_is_wanted(swinging, run, contents):
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--torque", "none", "--learn", "lengths",
                  "--method", "laplace", "--out", "f.png", "--out", "t.csv", *SMALL)  # fmt: skip
    assert outcome.exit_code == 0, outcome.output
    assert "Joint angles (rad) over 24 frames" in outcome.stdout
    lengths = [
        float(line.split("length ")[1].split(" ±")[0])
        for line in outcome.stdout.splitlines()
        if "±" in line and ": length" in line
    ]
    assert lengths == pytest.approx([0.8, 0.6], abs=0.02)
    idata = load_posterior("p.nc")
    assert "torque" not in idata["posterior"]
    table, _ = read_table("t.csv")
    assert not [name for name in table if "torque" in name]
    assert table["shoulder_angle"] == pytest.approx(-1.5 + 0.5 * np.sin(4 * np.arange(24) / 30), abs=0.05)
    assert {"p.nc", "f.png", "t.csv"} <= set(contents(swinging))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--method", "nuts"), "expected a method among smc, laplace, got 'nuts'"),
        (("--out", "t.sto"), "t.sto: a kinematic posterior has no torques"),
        (("--zero-torque",), "--zero-torque: has no part in --torque none"),
        (("--set", f"forces={__file__}"), "error: --set forces: has no part in --torque none"),
        (("--set", "filters_per_task=2"), "error: --set filters_per_task: has no part in --torque none"),
    ],
)
def test_what_has_no_part_in_it_is_refused(swinging, run, contents, options, said):
    before = set(contents(swinging))
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--torque", "none", *options)
    assert outcome.exit_code == 2
    assert said in outcome.stderr
    assert set(contents(swinging)) == before


def test_a_comparison_has_no_torque_of_none(swinging, run):
    outcome = run(
        "compare", "rec.csv", "--body", "arm.toml", "--methods", "laplace", "--out", "DIR", "--torque", "none"
    )
    assert outcome.exit_code == 2
    assert "unknown torque process 'none': known are" in outcome.stderr


def test_a_kinematic_posterior_has_no_torques_to_export(swinging, run):
    assert (
        run(
            "infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--torque", "none", "--method", "laplace", *SMALL
        ).exit_code
        == 0
    )
    outcome = run("plot", "p.nc", "--out", "t.sto")
    assert outcome.exit_code == 2
    assert "no torques" in outcome.stderr
    assert not Path("t.sto").exists()
