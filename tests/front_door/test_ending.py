"""How a command ends where it is terminated, or where its words cannot be printed: whole or absent, in one line."""

import os
import signal
import sys
from pathlib import Path

import pytest

import invdyn.inference
import invdyn.outputs
from invdyn.cli import app

if not hasattr(signal, "SIGKILL"):
    pytest.skip("needs POSIX signals", allow_module_level=True)

INFER = ("infer", "rec.csv", "--body", "arm.toml", "--out", "p.nc", "--out", "f.png")
SIMULATE = ("simulate", "--body", "arm.toml", "--out", "s.csv", "--truth", "t.csv", "--duration", "0.5")
ENDS = [pytest.param(signal.SIGTERM, 143, id="terminated"), pytest.param(signal.SIGHUP, 129, id="hung up")]

pytestmark = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs POSIX signals and /dev/full")


@pytest.mark.parametrize(("number", "code"), ENDS)
def test_terminated_at_work_it_writes_nothing(folder, monkeypatch, run, contents, number, code):
    monkeypatch.setattr(invdyn.inference, "infer", lambda *_, **__: signal.raise_signal(number))
    before, handler = contents(folder), signal.getsignal(number)
    outcome = run(*INFER)
    assert outcome.exit_code == code
    assert outcome.stderr == "terminated: what was not finished was not written\n"
    assert contents(folder) == before
    assert signal.getsignal(number) == handler


@pytest.mark.parametrize(("number", "code"), ENDS)
def test_terminated_while_it_writes_it_leaves_what_was_there(
    folder, quick_inference, monkeypatch, run, contents, number, code
):
    (folder / "p.nc").write_bytes(b"an earlier result")
    before = contents(folder)
    draw = invdyn.outputs.save_figure

    def save_figure(figure, path):
        draw(figure, path)
        signal.raise_signal(number)

    monkeypatch.setattr(invdyn.outputs, "save_figure", save_figure)
    outcome = run(*INFER, "--out", "f.gif")
    assert outcome.exit_code == code
    assert contents(folder) == before


def test_a_signal_that_is_ignored_stays_so(folder, quick_inference, monkeypatch, run):
    """As under nohup."""
    infer = invdyn.inference.infer

    def hung_up(*arguments, **options):
        signal.raise_signal(signal.SIGHUP)
        return infer(*arguments, **options)

    monkeypatch.setattr(invdyn.inference, "infer", hung_up)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run(*INFER).exit_code == 0
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.fixture
def printing_to(monkeypatch, capfd):
    """Function of a file for stdout and a command line -> its exit code and lines on stderr."""

    def call(stdout, *arguments):
        with monkeypatch.context() as patch, stdout:
            patch.setattr(sys, "stdout", stdout)
            with pytest.raises(SystemExit) as ended:
                app([str(word) for word in arguments], prog_name="invdyn")
        return ended.value.code, capfd.readouterr().err.splitlines()

    return call


def full():
    return open("/dev/full", "w", encoding="utf-8")


def without_reader():
    reader, writer = os.pipe()
    os.close(reader)
    return open(writer, "w", encoding="utf-8")


def test_on_a_full_disk_it_says_what_was_done(folder, printing_to):
    code, lines = printing_to(full(), *SIMULATE)
    assert lines == ["error: wrote s.csv, t.csv; could not print: No space left on device"]
    assert code == 74
    assert Path("s.csv").stat().st_size > 0
    assert Path("t.csv").stat().st_size > 0  # what comes after the first words that fail


def test_several_outputs_are_named(folder, printing_to, quick_inference):
    code, lines = printing_to(full(), *INFER)
    assert lines == ["error: wrote p.nc, f.png; could not print: No space left on device"]
    assert code == 74


@pytest.mark.parametrize("words", [("--version",), ("--help",)])
def test_help_that_cannot_be_printed_is_one_line(printing_to, words):
    code, lines = printing_to(full(), *words)
    assert (code, lines) == (74, ["error: could not print: No space left on device"])


def test_a_reader_that_has_left_takes_nothing_from_the_files(folder, printing_to):
    """As in `invdyn simulate … | head`: without a word, and not as if all had been read."""
    code, lines = printing_to(without_reader(), *SIMULATE)
    assert (code, lines) == (1, [])
    assert Path("s.csv").exists()
    assert Path("t.csv").exists()


def test_an_error_stays_the_error(folder, printing_to):
    code, lines = printing_to(full(), "infer", "no.csv", *INFER[2:])
    assert code == 2
    assert len(lines) == 1
    assert lines[0].startswith("error: no.csv")
