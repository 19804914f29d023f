"""A process of the command line imports no more than it uses."""

import os
import subprocess
import sys

import pytest

WRONG_UNIT = """
import sys
from invdyn.cli import app
sys.argv = ["invdyn", "infer", *sys.argv[1:], "--body", "paper_planar_arm", "--out", "o.nc"]
try:
    app()
except SystemExit as ended:
    assert ended.code == 2, ended.code
assert not {"torch", "arviz.data"} & {*sys.modules}, "imported"
"""


OF_A_NETWORK = """scorer,net,net,net
bodyparts,elbow,elbow,elbow
coords,x,y,likelihood
0,1,2,1
1,1,2,1
"""


@pytest.mark.parametrize(
    ("table", "options", "message"),
    [
        ("time,elbow_x,elbow_y\n0,1,2\n0.1,1,2\n", ("--units", "furlong"), "unknown unit 'furlong'"),
        (OF_A_NETWORK, ("--fps", "30"), "a DeepLabCut file does not say its units"),
    ],
    ids=["wrong", "missing"],
)
def test_wrong_and_missing_units_do_not_wait_for_torch(tmp_path, table, options, message):
    path = tmp_path / "r.csv"
    path.write_text(table)
    command = [sys.executable, "-W", "ignore", "-c", WRONG_UNIT, str(path), *options]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert message in done.stderr


WHAT_COMMANDS_USE = """
import sys
import invdyn.cli
import invdyn.diagnosis.check.visible
import invdyn.outputs
from invdyn.inference import infer
loaded = {"arviz.plots", "arviz.stats", "scipy.signal", "scipy.stats", "torch._dynamo"} & {*sys.modules}
assert not loaded, loaded

import arviz.stats
import arviz as az
assert az.hdi is arviz.stats.hdi
assert az.plot_trace is sys.modules["arviz.plots"].plot_trace
assert az.InferenceData is sys.modules["arviz.data"].InferenceData
"""


def test_plots_and_statistics_of_arviz_come_when_asked_for():
    command = [sys.executable, "-W", "ignore", "-c", WHAT_COMMANDS_USE]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr
