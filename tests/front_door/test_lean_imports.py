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
assert not {"torch", "arviz"} & {*sys.modules}, "imported"
"""


def test_a_wrong_unit_does_not_wait_for_torch(tmp_path):
    table = tmp_path / "r.csv"
    table.write_text("time,elbow_x,elbow_y\n0,1,2\n0.1,1,2\n")
    command = [sys.executable, "-W", "ignore", "-c", WRONG_UNIT, str(table)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ)
    assert done.returncode == 0, done.stderr
    assert "unknown unit 'furlong'" in done.stderr
