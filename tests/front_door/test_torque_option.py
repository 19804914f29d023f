"""`--torque`: a process by name, or by default a mixture of some."""

import json

import pytest

from invdyn.inference import load_posterior

SMALL = ("--method", "laplace", "--filters", 2, "--set", "draws=2")


@pytest.mark.long
def test_the_most_probable_is_taken_and_named(folder, run):
    run(
        "simulate",
        "--body",
        "arm.toml",
        "--out",
        "rec.csv",
        "--duration",
        "0.8",
        "--fps",
        "40",
        "--set",
        "encoders=1e-4",
    )
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", *SMALL)
    assert outcome.exit_code == 0, outcome.output
    settings = json.loads(load_posterior("p.nc").attrs["settings"])
    evidence = settings["torque_evidence"]
    assert set(evidence) == {"Matern32", "SmoothAndRough"}
    best = settings["torque_process"]
    assert evidence[best] == max(evidence.values())
    (line,) = (line for line in outcome.stdout.splitlines() if line.startswith("torque process"))
    assert line.startswith(f"torque process {best}, by evidence; ")
    behind = {name: evidence[best] - value for name, value in evidence.items() if name != best}
    for name, nats in behind.items():
        assert f"{name} {nats:.1f} nat" in line


@pytest.mark.parametrize("name", ["smooth", "AUTO"])
def test_an_unknown_one_is_refused(folder, run, name):
    run("simulate", "--body", "arm.toml", "--out", "rec.csv", "--duration", "0.8", "--fps", "40")
    outcome = run("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--torque", name)
    assert outcome.exit_code == 2
    assert f"unknown torque process '{name}': known are ornstein_uhlenbeck" in outcome.stderr
    assert "matern52, recurrent, smooth_and_rough, auto" in outcome.stderr
