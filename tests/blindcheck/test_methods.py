"""Methods that a blind run calls: a command for each case, and one process for all cases."""

import json
import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from invdyn.blindcheck.methods import Ours, Theirs

WRITES = (
    "import json, pathlib, sys; "
    "found = dict(gap=dict(detected=False), causes=[], told=sys.argv[2:]); "
    "pathlib.Path(sys.argv[1], 'diagnosis.json').write_text(json.dumps(found))"
)


@pytest.fixture
def folders(tmp_path):
    """A case's and its diagnosis' folder, with blanks in their names."""
    case, out = tmp_path / "a case", tmp_path / "its diagnosis"
    case.mkdir()
    out.mkdir()
    return case, out


def command(program, *words):
    return f'{shlex.quote(sys.executable)} -c "{program}" {{out}} {" ".join(words)}'


@pytest.mark.parametrize("other", [False, True])
def test_a_command_gets_the_paths_of_a_case(folders, other):
    """Each place as one word, with any blanks in it; no second recording where there is none."""
    case, out = folders
    if other:
        (case / "other.csv").touch()
    with Theirs(command(WRITES, "{recording}", "--body={body}", "{held_out}")) as method:
        assert method(case, out) is None
    told = [str(case / "recording.csv"), f"--body={case / 'body.toml'}", str(case / "other.csv") if other else ""]
    assert json.loads((out / "diagnosis.json").read_text())["told"] == told


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("import sys; print('so far'); sys.exit('no arm in it')", ("exit code 1", "so far", "no arm in it")),
        ("print('forgot to write')", ("exit code 0", "forgot to write")),
        (WRITES.replace("gap=", "gaps="), ("diagnosis.json: expected the key 'gap', got 'gaps', 'causes'",)),
        (WRITES.replace("json.dumps", "repr"), ("diagnosis.json: expected JSON in UTF-8",)),
    ],
)
def test_a_command_that_gives_no_diagnosis_is_quoted(folders, program, said):
    with Theirs(command(program)) as method:
        wrong = method(*folders)
    assert all(words in wrong for words in said)


def test_a_process_that_dies_is_replaced(tmp_path, monkeypatch):
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"#!{sys.executable}\nimport json, os, sys\n"
        f"print(os.getpid(), file=open({str(tmp_path / 'pids')!r}, 'a'), flush=True)\n"
        "for line in sys.stdin:\n"
        "    if json.loads(line)['case'].endswith('bad'):\n        os._exit(3)\n"
        "    print(json.dumps({'seconds': 0.1, 'error': None, 'pid': os.getpid()}), flush=True)\n"
    )
    stand_in.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(stand_in))
    with Ours() as method:
        assert method(tmp_path / "good", tmp_path) is None
        assert "exit code 3" in method(tmp_path / "bad", tmp_path)
        assert method(tmp_path / "good", tmp_path) is None
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 2
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks at /proc")
def test_who_asks_may_be_killed_in_the_middle_of_a_case(folders):
    """The process that diagnoses ends, too: here it waits for ever for a file that is never written."""
    case, out = folders
    os.mkfifo(case / "case.json")
    asks = "from pathlib import Path; from invdyn.blindcheck.methods import Ours; Ours()"
    with subprocess.Popen([sys.executable, "-c", f"{asks}(Path({str(case)!r}), Path({str(out)!r}))"]) as process:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        _until(lambda: children.read_text().split())
        child = Path("/proc", children.read_text().split()[0])
        _until(lambda: b"worker" in (child / "cmdline").read_bytes())
        writer = _opened_by_a_reader(case / "case.json")
        process.send_signal(signal.SIGTERM)
        process.wait()
    _until(lambda: not (child / "cmdline").exists() or not (child / "cmdline").read_bytes())
    os.close(writer)


def _opened_by_a_reader(fifo):
    """The write end of a pipe in the file system, open as soon as it is read."""
    found = []

    def opened():
        with suppress(OSError):
            found.append(os.open(fifo, os.O_WRONLY | os.O_NONBLOCK))
        return found

    _until(opened)
    return found[0]


def _until(true):
    """However long it takes: pytest ends what waits for ever."""
    while not true():
        time.sleep(0.1)
