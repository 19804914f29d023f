"""A process of the command line imports no more than it uses."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from invdyn.inference import infer
from invdyn.inputs import load_body
from invdyn.simulate import paper_arm, record

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
        (OF_A_NETWORK, ("--fps", "30"), "DeepLabCut files do not say their units"),
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

from arviz.labels import BaseLabeller
from arviz.rcparams import rcParams
import arviz.stats
import arviz as az
rcParams["plot.max_subplots"] = 7
assert az.plot_trace
assert az.rcParams is rcParams and az.rcParams["plot.max_subplots"] == 7
assert az.labels.BaseLabeller is sys.modules["arviz.plots.traceplot"].BaseLabeller is BaseLabeller
assert type(az) is type(sys), type(az)
assert az.hdi is arviz.stats.hdi
assert az.plot_trace is sys.modules["arviz.plots"].plot_trace
assert az.InferenceData is sys.modules["arviz.data"].InferenceData
"""


BY_SIX_THREADS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from invdyn import arviz_on_demand
arviz_on_demand.register()
import arviz as az

if sys.argv[1:]:  # a run that fails leaves no half package
    type(az.__spec__.loader).exec_module = lambda self, module: 1 / 0
    try:
        az.plot_trace
    except ZeroDivisionError:
        pass
    sys.exit("arviz" in sys.modules)

barrier, names = Barrier(6), ("InferenceData", "rcParams", "hdi")
def read(k):
    barrier.wait()
    return [getattr(az, name) for name in (names if k % 2 else names[::-1])]
with ThreadPoolExecutor(6) as pool:
    found = list(pool.map(read, range(6)))
assert {tuple(map(id, each if k % 2 else each[::-1])) for k, each in enumerate(found)} == {
    tuple(id(getattr(az, name)) for name in names)
}
"""


@pytest.mark.parametrize(
    "words", [(WHAT_COMMANDS_USE,), pytest.param((BY_SIX_THREADS,), marks=pytest.mark.long), (BY_SIX_THREADS, "fails")]
)
def test_plots_and_statistics_of_arviz_come_when_asked_for(words):
    command = [sys.executable, "-W", "ignore", "-c", *words]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr


def test_torch_is_not_asked_for_a_common_shape(monkeypatch):
    """`torch.broadcast_shapes` imports SymPy: half a second of CPU in each process."""

    def asked(*shapes):
        raise AssertionError(f"torch was asked for the common shape of {shapes}")

    monkeypatch.setattr(torch, "broadcast_shapes", asked)
    body = load_body("paper_planar_arm")
    recording, _ = record(paper_arm(body, num_frames=12), 0)
    found = infer(recording, body, method="laplace", num_filters=4)
    assert np.isfinite(found.attrs["log_evidence"])
