"""A process of the command line imports no more than it uses."""

import os
import subprocess
import sys

WRONG_UNIT = """
import sys
from invdyn.cli import app
sys.argv = ["invdyn", "infer", sys.argv[1], "--body", "paper_planar_arm", "--units", "furlong", "--out", "o.nc"]
try:
    app()
except SystemExit as ended:
    assert ended.code == 2, ended.code
assert not {"torch", "arviz.data"} & {*sys.modules}, "imported"
"""


def test_a_wrong_unit_does_not_wait_for_torch(tmp_path):
    table = tmp_path / "r.csv"
    table.write_text("time,elbow_x,elbow_y\n0,1,2\n0.1,1,2\n")
    command = [sys.executable, "-W", "ignore", "-c", WRONG_UNIT, str(table)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert "unknown unit 'furlong'" in done.stderr


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
