"""`invdyn blind`, ended while a case is being diagnosed, continues with that case and to the same score."""

import json
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from invdyn.blindcheck.run import BlindRun

if not hasattr(signal, "SIGKILL"):
    pytest.skip("needs POSIX signals", allow_module_level=True)
pytest.importorskip("mujoco")
pytestmark = pytest.mark.usefixtures("hasty")

METHOD = '''
"""Says that there is no gap; in the second case it waits for as long as a file `wait` stands above the run."""
import json, os, pathlib, sys, time

out = pathlib.Path(sys.argv[1])
above, parent = out.parent.parent.parent, os.getppid()
with open(above / "log.txt", "a") as log:
    log.write(out.name + "\\n")
while out.name == "case-0001" and (above / "wait").exists() and os.getppid() == parent:
    time.sleep(0.01)
gap = {"detected": False, "probability": 0.1, "elpd_per_frame": {"nominal": 1.0, "corrected": 1.0}}
causes = [{"effects": [], "probability": 0.9}]
found = {"schema": 1, "gap": gap, "causes": causes, "outside_catalogue": {"probability": 0.1}}
(out / "diagnosis.json").write_text(json.dumps(found))
'''
COUNTS = {"none": 2, "commanded": 1}


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="sends POSIX signals")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -9), (signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_ended_in_the_middle_of_a_case(tmp_path, monkeypatch, run, started, number, code):
    monkeypatch.chdir(tmp_path)
    Path("method.py").write_text(METHOD)
    Path("seed.txt").write_text("11\n")
    for name in ("run", "whole"):  # the cases follow from the seed; made here, where that is quick
        made = BlindRun(name, COUNTS, 11)
        made.check()
        made.make()
    command = f"{shlex.quote(sys.executable)} {shlex.quote(str(tmp_path / 'method.py'))} {{out}}"
    options = ("--seed-file", "seed.txt", "--kinds", "none=2,commanded=1", "--workers", "1", "--set", "confine=no")

    def call(out):
        return ("blind", "--out", out, *options, "--method-command", command)

    Path("wait").touch()
    program = (sys.executable, "-W", "ignore", "-m", "invdyn")
    process = started(*program, *call("run"), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    first, log = Path("run/diagnoses/case-0000/took.json"), Path("log.txt")
    while not (log.exists() and "case-0001" in log.read_text()):
        assert process.poll() is None
        time.sleep(0.01)
    assert first.exists()
    assert not Path("run/diagnoses/case-0001/took.json").exists()
    took = first.read_bytes()
    process.send_signal(number)
    _, errors = process.communicate()
    assert process.returncode == code
    if code > 0:
        assert errors.splitlines()[-1].endswith("what was not finished was not written")
        assert "Traceback" not in errors
    assert not Path("run/answers.json").exists()
    assert not Path("run/scores.json").exists()

    Path("wait").unlink()
    resumed, whole = run(*call("run")), run(*call("whole"))
    assert (resumed.exit_code, whole.exit_code) == (0, 0), resumed.output + whole.output
    assert first.read_bytes() == took  # it was not diagnosed again
    assert log.read_text().split()[:4] == ["case-0000", "case-0001", "case-0001", "case-0002"]
    one, other = (json.loads(Path(name, "scores.json").read_text()) for name in ("run", "whole"))
    assert one["measures"] == other["measures"]
    assert one["about"]["answers_sha256"] == other["about"]["answers_sha256"]
