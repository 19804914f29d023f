"""`invdyn blind` from end to end with methods of others, and what the answers are kept from."""

import json
import shlex
import shutil
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType

import pytest

from invdyn.blindcheck.cases import Case, make_case
from invdyn.blindcheck.commitment import read_opened
from invdyn.blindcheck.injected_effects import CATALOGUE
from invdyn.blindcheck.run import BlindRun
from invdyn.blindcheck.worker import serve
from invdyn.recordings import InputError

pytest.importorskip("mujoco")
pytestmark = pytest.mark.usefixtures("hasty")

METHOD = '''
"""Says that there is no gap, after looking for the answers; fails where a file named `fail` stands above."""
import json, pathlib, sys

recording, body, out = map(pathlib.Path, sys.argv[1:])
top = out.parent.parent
above = [path for path in top.rglob("*") if path.is_file()]
assert not [path for path in above if path.name in ("answers.json", "scores.json")], above
shown = "".join(path.read_text() for path in above if path.suffix == ".json" and path.parent.parent.name != "diagnoses")
assert "viscous" not in shown and "dprime" not in shown and "kind" not in shown
assert pathlib.Path.cwd() == recording.parent and json.loads(pathlib.Path("case.json").read_text())["regime"]
with open(top.parent / "log.txt", "a") as log:
    log.write(out.name + "\\n")
if (top.parent / "fail").exists() and out.name == "case-0001":
    sys.exit("it is too hard")
gap = {"detected": False, "probability": 0.1, "elpd_per_frame": {"nominal": 1.0, "corrected": 1.0}}
causes = [{"effects": [], "probability": 0.9}]
found = {"schema": 1, "gap": gap, "causes": causes, "outside_catalogue": {"probability": 0.1}}
(out / "diagnosis.json").write_text(json.dumps(found))
'''


@pytest.fixture
def blind(tmp_path, monkeypatch, run):
    """Function that runs three cases by the method above."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "method.py").write_text(METHOD)
    command = f"{shlex.quote(sys.executable)} {shlex.quote(str(tmp_path / 'method.py'))} {{recording}} {{body}} {{out}}"

    def call(*more, seed=("--seed", 11)):
        kinds = ("--kinds", "none=2,commanded=1", "--workers", 1, "--set", "confine=no")
        return run("blind", "--out", "run", *seed, *kinds, "--method-command", command, *more)

    return call


def test_a_run_is_sealed_diagnosed_scored_and_resumed(blind, tmp_path):
    (tmp_path / "fail").touch()
    outcome = blind()
    assert outcome.exit_code == 0, outcome.output
    kept, first, *_ = outcome.stdout.splitlines()
    assert "in the open, as your own user" in kept
    assert "warning: the seed stands on the command line" in outcome.stderr
    commitment = first.rpartition(" ")[2]
    assert first.startswith("sealed answers, SHA-256")
    answers = read_opened("run/answers.json", commitment)
    assert sorted(answer["kind"] for answer in answers.values()) == ["commanded", "none", "none"]
    scores = json.loads(Path("run/scores.json").read_text())
    figures = {(kind, m["name"]): m["value"] for kind, all_ in scores["measures"].items() for m in all_}
    assert figures["all", "no diagnosis"] == pytest.approx(1 / 3)
    assert "it is too hard" in Path("run/diagnoses/case-0001/failed.txt").read_text()
    assert scores["about"]["answers_sha256"] == commitment
    assert Path("run/blind.html").read_text().startswith("<!doctype html>")

    (tmp_path / "fail").unlink()
    (tmp_path / "seed.txt").write_text("11\n")
    again = blind(seed=("--seed-file", "seed.txt"))
    assert again.exit_code == 0, again.output
    assert again.stdout.splitlines()[1] == first  # the same cases, the same seal
    assert "command line" not in again.stderr
    assert Path("log.txt").read_text().split() == ["case-0000", "case-0001", "case-0002", "case-0001"]
    scores = json.loads(Path("run/scores.json").read_text())
    figures = {(kind, m["name"]): m["value"] for kind, all_ in scores["measures"].items() for m in all_}
    assert figures["all", "no diagnosis"] == 0
    assert figures["none", "false alarms"] == 0
    assert figures["commanded", "a gap is detected"] == 0
    assert not Path("run/diagnoses/case-0001/failed.txt").exists()

    before = {path: path.read_bytes() for path in Path("run").rglob("*") if path.is_file()}
    other = blind(seed=("--seed", 12))
    assert other.exit_code == 2
    assert "other cases" in other.stderr
    assert {path: path.read_bytes() for path in Path("run").rglob("*") if path.is_file()} == before


@pytest.fixture
def making(tmp_path, monkeypatch):
    """Function that makes three cases in a folder; what was launched; and whether the next one stops half-written."""
    launched, breaks = [], []
    write = Case.write

    def broken(case, folder):
        launched.append(Path(folder).name)
        write(case, folder)
        if breaks and launched[-1] == breaks[-1]:
            breaks.pop()
            (Path(folder) / "recording.csv").write_text("half")
            raise KeyboardInterrupt

    monkeypatch.setattr(Case, "write", broken)

    def make(name, seed=5):
        launched.clear()
        blind = BlindRun(tmp_path / name, {"none": 3}, seed=seed)
        blind.check()
        return blind.make()

    return make, launched, breaks


@pytest.mark.long
def test_cases_that_were_made_before_an_interruption_are_not_made_again(making, tmp_path):
    make, launched, breaks = making
    commitment, names = make("whole"), ["case-0000", "case-0001", "case-0002"]
    assert launched == names
    breaks.append(names[1])
    with suppress(KeyboardInterrupt):
        make("parts")
    assert not (tmp_path / "parts" / "sealed.json").exists()
    assert make("parts") == commitment
    assert launched == names[1:]
    for path in (tmp_path / "whole" / "cases").rglob("*.*"):
        assert (tmp_path / "parts" / path.relative_to(tmp_path / "whole")).read_bytes() == path.read_bytes()
    assert make("parts") == commitment
    assert launched == []


@pytest.mark.long
def test_what_another_run_left_is_no_case_of_this_one(making, tmp_path):
    make, launched, breaks = making
    commitment = make("whole")
    for seed, last in ((5, "case-0002"), (6, "case-0000"), (5, None)):
        breaks[:] = [last] if last else []
        with suppress(KeyboardInterrupt):
            again = make("parts", seed)
    assert launched == ["case-0000", "case-0001", "case-0002"]
    assert again == commitment
    shutil.rmtree(tmp_path / "parts" / "cases")
    with pytest.raises(InputError, match="other cases"):
        make("parts", 6)
    assert json.loads((tmp_path / "parts" / "sealed.json").read_text())["sha256"] == commitment


BAD = {
    "an unknown kind": (("--kinds", "weird"), "commanded"),
    "no number": (("--kinds", "none=0"), "number of cases"),
    "no place for the answer": (("--method-command", "prog {recording}"), "{out}"),
    "no words": (("--method-command", "prog 'x {out}"), "expected words as in a shell"),
    "no such program": (("--method-command", "no-such-program {out}"), "no-such-program"),
    "no cases": (("--cases", "0"), "--cases"),
    "two seeds": (("--seed", "1", "--seed-file", "seed.txt"), "expected one of them"),
    "no seed file": (("--seed-file", "none.txt"), "none.txt"),
    "a negative seed": (("--seed", "-1"), "one whole number from 0"),
    "a seed in words": (("--seed", "many"), "one whole number from 0"),
    "a large seed": (("--seed", "9" * 5000), "one whole number from 0"),
    "no such bodies": (("--set", "bodies=cubes"), "bodies: expected plane, or space with mujoco"),
    "bodies in space by pinocchio": (("--set", "bodies=space", "--engine", "pinocchio"), "got 'space' with pinocchio"),
    "nothing on standard input": (("--seed", "-"), "standard input: expected a seed"),
    "a user and no method": (("--set", "method_user=nobody"), "--method-command"),
    "no such user": (
        ("--method-command", "true {out}", "--set", "method_user=no such"),
        "expected a user of this machine",
    ),
}


@pytest.mark.parametrize(("more", "named"), BAD.values(), ids=BAD.keys())
def test_bad_calls(tmp_path, monkeypatch, run, more, named):
    monkeypatch.chdir(tmp_path)
    outcome = run("blind", "--out", "run", *more)
    assert outcome.exit_code == 2, outcome.output
    (line,) = outcome.stderr.splitlines()
    assert named in line
    assert not Path("run").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path, run):
    (tmp_path / "thesis.txt").write_text("years of work")
    outcome = run("blind", "--out", tmp_path)
    assert outcome.exit_code == 2
    assert "thesis.txt" in outcome.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


# -- our own method, in its process ---------------------------------------------------------------------------


def test_the_process_apart_reads_a_case_and_survives_what_fails(tmp_path, monkeypatch):
    called = []
    fake = ModuleType("invdyn.diagnosis.diagnose")

    class Found:
        def to_json(self):
            return {"schema": 1}

    def diagnose(recording, body, **options):
        called.append((recording, body, options))
        if len(called) == 2:
            raise ZeroDivisionError("a bug")
        return Found()

    fake.diagnose = diagnose
    monkeypatch.setitem(sys.modules, fake.__name__, fake)
    case = make_case(5, "leave_one_out", "armature")
    case.write(tmp_path / "case")
    job = {"case": str(tmp_path / "case"), "out": str(tmp_path / "out"), "without": ["payload"]}
    lines = [json.dumps(each) for each in (job, job, job | {"case": str(tmp_path / "none")}, job)]
    replies = []
    serve(lines, replies.append)
    recording, body, options = called[0]
    assert options["without"] == ("armature", "payload")
    assert options["passive"] is False
    assert body == case.body
    assert recording.num_frames == case.recording.num_frames
    assert json.loads((tmp_path / "out/diagnosis.json").read_text()) == {"schema": 1}
    assert replies[0]["seconds"] >= 0
    assert "ZeroDivisionError: a bug" in replies[1]["error"]
    assert "case.json" in replies[2]["error"]
    assert "seconds" in replies[3]


def test_the_oracle_is_given_the_effect_and_nothing_else(tmp_path, monkeypatch):
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"#!{sys.executable}\nimport json, pathlib, sys\n"
        "for line in sys.stdin:\n"
        "    job = json.loads(line)\n"
        "    out, shown = pathlib.Path(job['out']), bool(job['without'])\n"
        "    gap = {'detected': True, 'elpd_per_frame': {'nominal': 1.0, 'corrected': 3.0 if shown else 2.0}}\n"
        "    found = {'gap': gap, 'causes': [], 'without': job['without']}\n"
        "    (out / 'diagnosis.json').write_text(json.dumps(found))\n"
        "    print(json.dumps({'seconds': 0.1}), flush=True)\n"
    )
    stand_in.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(stand_in))
    run = BlindRun(tmp_path / "run", {"commanded": 2, "none": 1}, seed=5)
    run.check()
    run.make()
    run.diagnose()
    scores = run.score(oracle=True)
    figure = scores.measure("commanded", "share of the gap closed, of an oracle's")
    assert (figure.value, figure.n) == (0.5, 2)
    shown = sorted((tmp_path / "run/oracle").iterdir())
    answers = read_opened(tmp_path / "run/answers.json")
    assert {path.name for path in shown} == {name for name, answer in answers.items() if answer["effects"]}
    for path in shown:
        (effect,) = answers[path.name]["effects"]
        struck = json.loads((path / "diagnosis.json").read_text())["without"]
        assert set(CATALOGUE) - set(struck) == {effect["effect"]}
