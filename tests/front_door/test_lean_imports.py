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
assert not {"torch", "arviz"} & {*sys.modules}, "imported"
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
