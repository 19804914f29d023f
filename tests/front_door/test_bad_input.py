"""Anything wrong ends with one clear line and an exit code, and leaves no half-written file."""

import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import invdyn.inference

HEADER = "time,elbow_x,elbow_y,wrist_x,wrist_y\n"
GIVEN = {"arm.toml", "rec.csv", "hand.csv"}


@pytest.fixture
def refused(folder, run, contents):
    """Function that makes a call and checks the refusal."""

    def refused(arguments, named, exit_code=2, kind="error"):
        """One line on stderr that names the culprit, the exit code, and the folder as it was before."""
        before = contents(folder)
        outcome = run(*arguments)
        assert outcome.exit_code == exit_code, outcome.output
        assert not outcome.stdout
        (line,) = outcome.stderr.splitlines()
        assert line.startswith(f"{kind}: ")
        assert named in line
        assert contents(folder) == before

    return refused


# -- bad input: one clear line, exit code 2, nothing written ----------------------------------------------

INFER = ("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc")
BAD = {
    "no recording": (("infer", "none.csv", "--body", "arm.toml", "--out", "p.nc"), "none.csv"),
    "misspelt name": (("infer", "human-armm", "--body", "arm.toml", "--out", "p.nc"), "did you mean 'human-arm'"),
    "recording is a folder": (("infer", ".", "--body", "arm.toml", "--out", "p.nc"), "."),
    "no body": (("infer", "rec.csv", "--body", "none.toml", "--out", "p.nc"), "none.toml"),
    "body is a recording": (("infer", "rec.csv", "--body", "rec.csv", "--out", "p.nc"), "TOML"),
    "no folder for the output": ((*INFER[:-1], "nowhere/p.nc"), "nowhere/p.nc"),
    "output is a folder": ((*INFER[:-1], "."), "folder"),
    "figure nowhere": ((*INFER, "--out", "nowhere/f.png"), "nowhere/f.png"),
    "figure of unknown kind": ((*INFER, "--out", "f.jpg"), "f.jpg: an output ends in .nc or .png"),
    "film of unknown kind": ((*INFER, "--out", "f.avi"), "or .gif"),
    "no posterior among the outputs": (
        (*INFER[:-1], "x.png"),
        "expected one file for the posterior, such as posterior.nc",
    ),
    "two posteriors": ((*INFER, "--out", "t.nc"), "expected one file for the posterior, such as posterior.nc, got 2"),
    "a recording called as a posterior": (("simulate", "--body", "arm.toml", "--out", "s.nc"), "ends in .csv, got"),
    "a truth without an ending": (
        ("simulate", "--body", "arm.toml", "--out", "s.csv", "--truth", "truth"),
        "truth: a truth ends in .csv, got ''",
    ),
    "a check called as a table": (("check", "arm.toml", "rec.csv", "--out", "c.csv"), "a check ends in .json"),
    "a folder called as a page": (
        ("diagnose", "rec.csv", "--body", "arm.toml", "--out", "found.html"),
        "found.html: expected the name of a folder, got that of a file: leave .html out",
    ),
    "no mapping": (("check", "arm.toml", "rec.csv", "--map", "none.toml"), "error: --map none.toml: No such file"),
    "no recording in addition": (
        ("diagnose", "rec.csv", "--body", "arm.toml", "--out", "d", "--with=rec2.csv,none.csv"),
        "error: --with rec2.csv: no such file",
    ),
    "no labels": (
        ("train", "f.mp4", "--labels", "./none.csv", "--out", "n.safetensors"),
        "error: --labels none.csv: No such file",
    ),
    "no recording behind a flag": (
        (*INFER[:1], *INFER[2:], "--zero-torque", "none.csv"),
        "error: none.csv: no such file",
    ),
    "output over input": ((*INFER[:-1], "rec.csv"), "overwrite"),
    "two outputs of one name": ((*INFER, "--out", "t.csv", "--out", "./t.csv"), "two outputs"),
    "unknown method": ((*INFER, "--method", "magic"), "smc"),
    "no particles": ((*INFER, "--particles", "0"), "--particles"),
    "particles in words": ((*INFER, "--particles", "many"), "--particles"),
    "unknown option": ((*INFER, "--magic"), "--magic"),
    "missing option": ((*INFER[:2], *INFER[4:]), "--body"),
    "no output": (INFER[:-2], "--out: expected one file for the posterior"),
    "unknown command": (("magic",), "magic"),
    "frames in words": ((*INFER, "--frames", "all"), "50:250"),
    "frames backwards": ((*INFER, "--frames", "100:50"), "--frames is START:STOP, the first row"),
    "no frames": ((*INFER, "--frames=-5:-5"), "got -5:-5: no rows"),
    "a scale in words": ((*INFER, "--units", "px", "--scale", "small"), "expected metres a pixel, or body"),
    "a setting in words": ((*INFER, "--set", "filters_per_task=many"), "expected a whole number from 1 on"),
    "an unknown setting": ((*INFER, "--set", "magic=1"), "a name of base, offset"),
    "a setting without a value": ((*INFER, "--set", "plane"), "expected NAME=VALUE"),
    "a scale of metres": ((*INFER, "--units", "px", "--scale", "30"), "--scale 30 makes these keypoints larger"),
    "one frame": ((*INFER, "--frames", "3:4"), "2 frames"),
    "frames past the end": ((*INFER, "--frames", "50:"), "2 frames"),
    "unknown unit": ((*INFER, "--units", "inch"), "inch"),
    "frame rate given twice": ((*INFER, "--fps", "30"), "--fps"),
    "centimetres for metres": ((*INFER, "--units", "cm"), "--units"),
    "unknown format": ((*INFER, "--set", "format=magic"), "magic"),
    "a base that is not there": ((*INFER, "--set", "base=hip"), "expected a keypoint 'hip', for --set base, got "),
    "no truth": ((*INFER, "--set", "truth=none.csv"), "none.csv"),
    "truth of another body": ((*INFER, "--set", "truth=hand.csv"), "elbow"),
    "truth is a recording": ((*INFER, "--set", "truth=rec.csv"), "rec.csv"),
    "no posterior": (("plot", "none.nc", "--out", "f.png"), "none.nc"),
    "posterior is a text": (("plot", "rec.csv", "--out", "f.png"), "rec.csv"),
    "simulate no time": (("simulate", "--body", "arm.toml", "--out", "s.csv", "--duration", "0"), "2"),
    "simulate for ever": (
        ("simulate", "--body", "arm.toml", "--out", "s.csv", "--duration", "inf"),
        "duration",
    ),
    "simulate no number": (("simulate", "--body", "arm.toml", "--out", "s.csv", "--noise", "nan"), "noise"),
    "simulate backwards": (("simulate", "--body", "arm.toml", "--out", "s.csv", "--fps", "-1"), "--fps"),
    "simulate nowhere": (("simulate", "--body", "arm.toml", "--out", "nowhere/s.csv"), "nowhere/s.csv"),
    "demo over a file": (("demo", "--out", "rec.csv"), "rec.csv"),
}


@pytest.mark.parametrize(("arguments", "named"), BAD.values(), ids=BAD.keys())
def test_bad_calls_end_with_one_line(folder, quick_inference, arguments, named, refused):
    refused(arguments, named)


RECORDINGS = {
    "empty": ("", "empty"),
    "header alone": (HEADER, "header"),
    "one frame": (HEADER + "0,1,0,2,0\n", "2 frames"),
    "no time": ("elbow_x,elbow_y,wrist_x,wrist_y\n1,0,2,0\n1,0,2,0\n", "time"),
    "a keypoint missing throughout": (HEADER + "0,1,0,,\n0.03,1,0,,\n", "wrist"),
    "a keypoint not in the file": ("time,elbow_x,elbow_y\n0,1,0\n0.03,1,0\n", "wrist"),
    "an unknown column": (HEADER.strip() + ",knee\n0,1,0,2,0,9\n0.03,1,0,2,0,9\n", "knee"),
    "infinite": (HEADER + "0,1,0,2,0\n0.03,inf,0,2,0\n", "inf"),
    "a word": (HEADER + "0,1,0,2,0\n0.03,one,0,2,0\n", "one"),
    "no time in a row": (HEADER + "0,1,0,2,0\n,1,0,2,0\n", "time"),
    "time twice": (HEADER + "0,1,0,2,0\n0,1,0,2,0\n", "repeats"),
    "time backwards": (HEADER + "1,1,0,2,0\n0,1,0,2,0\n", "backwards"),
    "pixels as metres": (HEADER + "0,100,0,200,0\n0.03,100,1,200,1\n", "px"),
    "short row": (HEADER + "0,1,0,2,0\n0.03,1\n", "3"),
    "numbers of frames": (HEADER + "0,1,0,2,0\n1,1,0,2,0\n2,1,0,2,0\n", "--units frames --fps"),
    "milliseconds": (HEADER + "0,1,0,2,0\n40,1,0,2,0\n80,1,0,2,0\n", "--units ms"),
    "days between rows": (HEADER + "0,1,0,2,0\n0.04,1,0,2,0\n0.08,1,0,2,0\n90000,1,0,2,0\n", "(--frames :3)"),
    "another case": (HEADER.replace("wrist", "Wrist") + "0,1,0,2,0\n0.04,1,0,2,0\n", "closest: 'Wrist'"),
    "three coordinates": (
        "time,elbow_x,elbow_y,elbow_z,wrist_x,wrist_y,wrist_z\n0,1,0,0,2,0,0\n0.03,1,0,0,2,0,0\n",
        "plane",
    ),
}


@pytest.mark.parametrize(("text", "named"), RECORDINGS.values(), ids=RECORDINGS.keys())
def test_bad_recordings_end_with_one_line(folder, text, named, refused):
    (folder / "rec.csv").write_text(text)
    refused(INFER, named)


BODIES = {  # what stands in the body file, what comes instead, what is named
    "negative mass": ("mass = 0.5", "mass = -0.5", "mass"),
    "zero length": ("length = 1.0", "length = 0.0", "length"),
    "no links": ("[[links]]", "[[bones]]", "links"),
    "broken TOML": ('"arm"', '"arm', "TOML"),
    "other keypoints": ('tip = "wrist"', 'tip = "hand"', "hand"),
    "other size": ("length = 1.0", "length = 0.1", "length"),
}


@pytest.mark.parametrize(("good", "bad", "named"), BODIES.values(), ids=BODIES.keys())
def test_bad_bodies_end_with_one_line(folder, quick_inference, refused, good, bad, named):
    text = (folder / "arm.toml").read_text()
    assert good in text
    (folder / "arm.toml").write_text(text.replace(good, bad))
    refused(INFER, named)


def test_truncated_posterior_ends_with_one_line(folder, quick_inference, run, refused):
    run(*INFER)
    whole = Path("p.nc").read_bytes()
    for length in (0, 100, len(whole) // 2, len(whole) - 1):
        Path("cut.nc").write_bytes(whole[:length])
        refused(("plot", "cut.nc", "--out", "f.png"), "cut.nc")


# -- interrupts and failures on the way ---------------------------------------------------------------------


@pytest.mark.parametrize("earlier", [None, b"an earlier result"])
def test_interrupt_during_inference_writes_nothing(folder, monkeypatch, earlier, refused):
    def infer(*_, progress, **__):
        progress(1, 3, "filter")
        raise KeyboardInterrupt

    monkeypatch.setattr(invdyn.inference, "infer", infer)
    if earlier is not None:
        (folder / "p.nc").write_bytes(earlier)
    refused((*INFER, "--out", "f.png"), "interrupted", 130, "interrupted")


def test_interrupt_during_writing_leaves_none_of_the_set(folder, quick_inference, monkeypatch, run, contents):
    import invdyn.outputs

    def save_film(idata, path, progress, overlay):
        with invdyn.recordings.atomic_path(path) as temporary:
            temporary.write_bytes(b"half a film")
            raise KeyboardInterrupt

    monkeypatch.setattr(invdyn.outputs, "save_film", save_film)
    outcome = run(*INFER, "--out", "f.gif", "--out", "f.png")
    assert outcome.exit_code == 130
    assert set(contents(folder)) == set(GIVEN)


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_control_c_ends_the_program(folder, contents, started):
    script = (
        "import sys, time\n"
        "import invdyn.inference\n"
        "from invdyn.cli import app\n"
        "def infer(*_, **__):\n    print('running', flush=True)\n    time.sleep(3600)\n"
        "invdyn.inference.infer = infer\n"
        "sys.argv[0] = 'invdyn'\n"
        "app()\n"
    )
    before = contents(folder)
    process = started(sys.executable, "-c", script, *INFER, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout.readline() == "running\n"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate()
    assert process.returncode == 130
    assert errors.splitlines() == ["interrupted: what was not finished was not written"]
    assert contents(folder) == before


def test_an_error_of_ours_is_not_dressed_up_as_bad_input(folder, monkeypatch, run):
    def infer(*_, **__):
        raise ValueError("a bug")

    monkeypatch.setattr(invdyn.inference, "infer", infer)
    outcome = run(*INFER)
    assert isinstance(outcome.exception, ValueError)
    assert outcome.exit_code == 1


def test_a_warning_takes_one_line(folder, make_posterior, monkeypatch, run):
    def infer(recording, body, **_):
        warnings.warn("the film is\n dark", UserWarning, stacklevel=1)
        return make_posterior(2, 12)

    monkeypatch.setattr(invdyn.inference, "infer", infer)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        outcome = run(*INFER)
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stderr == "warning: the film is dark\n"


WITHOUT = """
import sys
from invdyn.cli import app
try:
    app(sys.argv[1:])
finally:
    print(*sorted({"torch", "pyro", "arviz.data", "matplotlib", "scipy"} & set(sys.modules)))
"""


@pytest.mark.parametrize("command", ["infer", "diagnose", "compare"])
@pytest.mark.parametrize(
    ("recording", "body", "message"),
    [
        ("nosuch.csv", "paper_planar_arm", "error: nosuch.csv: no such file"),
        ("nosuch.csv", "nosuch.toml", "no such body file"),
    ],
)
def test_a_wrong_name_is_answered_before_anything_large_loads(command, recording, body, message, tmp_path):
    """Torch and ArviZ take seconds."""
    more = ["--methods", "smc"] if command == "compare" else []
    arguments = [command, recording, "--body", body, "--out", "p.nc" if command == "infer" else "d", *more]
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert run.returncode != 0
    assert message in run.stderr
    assert run.stdout.split() == []
