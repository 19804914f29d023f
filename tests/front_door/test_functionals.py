"""Peaks, impulses and work of torque paths: in the summary, and as a table of their own."""

import io

import numpy as np
import pandas as pd
import pytest

from invdyn.inference import functional_table
from invdyn.outputs import OutputFiles
from invdyn.recordings import InputError
from invdyn.summary import summary_text

NAMES = ["peak", "peak_time", "impulse", "peak_rate", "work", "mean_power"]


def test_a_tidy_table_is_written(make_posterior, tmp_path):
    idata = make_posterior(2)
    paths = tmp_path / "arm.functionals.csv", tmp_path / "torques.csv"
    outputs = OutputFiles(paths)
    outputs.check()
    outputs.write(idata)
    table = pd.read_csv(paths[0])
    assert list(table.columns) == ["joint", "functional", "unit", "median", "q05", "q95", "truth"]
    assert table["functional"].tolist() == 2 * NAMES
    pd.testing.assert_frame_equal(table, pd.read_csv(io.StringIO(functional_table(idata).to_csv(index=False))))
    torque = idata["posterior"]["torque"].isel(joint=1).values
    lowest = np.quantile(np.abs(torque).max(-1), 0.05)
    peak = table[(table["joint"] == "elbow") & (table["functional"] == "peak")].iloc[0]
    assert max(abs(peak["q05"]), abs(peak["q95"])) >= lowest
    assert "shoulder_torque" in pd.read_csv(paths[1]).columns
    assert [line.split()[0] for line in outputs.listing().splitlines()[1:]] == ["functionals", "CSV"]


def test_the_summary_has_them_with_units(make_posterior):
    text = summary_text(make_posterior(2))
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert "at the frames' times, median and 90 % interval" in text
    for name, unit in zip(NAMES, ("N·m", "s", "N·m·s", "N·m/s", "J", "W"), strict=True):
        assert lines[name].count(f"] {unit}") == 2


def test_a_kinematic_posterior_has_none(make_posterior, tmp_path):
    idata = make_posterior(1)
    del idata["posterior"]["torque"]
    assert "whole paths" not in summary_text(idata)
    outputs = OutputFiles((tmp_path / "functionals.csv",))
    with pytest.raises(InputError, match="kinematic posterior has no torques to write"):
        outputs.check(torques=False)
