"""Methods that a blind run calls: ours, in one process for all cases, or any command."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import IO

from invdyn.blindcheck.answer_schema import unreadable
from invdyn.blindcheck.confined import Confined


class Ours(AbstractContextManager):
    """Our own method, in one process for all cases; if it dies, another process takes its place."""

    def __init__(self, threads: int | None = None):
        self._process: subprocess.Popen[str] | None = None
        self._environment = os.environ | ({"OMP_NUM_THREADS": str(threads)} if threads else {})

    def __exit__(self, *_: object) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            _ended(process)

    def __call__(self, case: Path, out: Path, without: Iterable[str] = ()) -> str | None:
        """Diagnose one case; returns what went wrong, if anything did."""
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "invdyn.blindcheck.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
                env=self._environment,
            )
        process, line = self._process, ""
        with suppress(OSError, ValueError):  # it is dead, or was ended because all of the run is
            job = {"case": str(case.resolve()), "out": str(out.resolve()), "without": list(without)}
            inbox, outbox = _pipes(process)
            inbox.write(json.dumps(job) + "\n")
            inbox.flush()
            line = outbox.readline()
        if not line:
            self._process = None
            return f"the diagnosis ended without an answer, exit code {_ended(process)}"
        return json.loads(line).get("error")


def _pipes(process: subprocess.Popen[str]) -> tuple[IO[str], IO[str]]:
    """What a process of :class:`Ours` reads, and what it writes."""
    assert process.stdin is not None
    assert process.stdout is not None
    return process.stdin, process.stdout


def _ended(process: subprocess.Popen[str]) -> int:
    """Exit code of a process that ends; its pipes are closed."""
    code = process.wait()
    inbox, outbox = _pipes(process)
    with suppress(OSError):  # what was still to be written to it
        inbox.close()
    outbox.close()
    return code


class Theirs(AbstractContextManager):
    """Another method: a process a case; words may hold {recording}, {body}, {out}, {held_out} and {case}, a folder."""

    def __init__(self, command: str, confined: Confined | None = None):
        self._words, self._confined = shlex.split(command), confined or Confined()
        self._process: subprocess.Popen | None = None
        self._ended = False

    def __exit__(self, *_: object) -> None:
        """End the case that is being diagnosed: another thread that waits for it then continues."""
        self._ended = True
        if self._process is not None:
            self._process.kill()

    def _started(self, process: subprocess.Popen) -> None:
        self._process = process
        if self._ended:
            process.kill()

    def __call__(self, case: Path, out: Path, without: Iterable[str] = ()) -> str | None:
        """Diagnose one case; returns what went wrong, if anything did."""
        case, out = case.resolve(), out.resolve()
        places: dict[str, Path | str] = {
            "case": case,
            "recording": case / "recording.csv",
            "body": case / "body.toml",
            "out": out,
        }
        places["held_out"] = case / "other.csv" if (case / "other.csv").exists() else ""
        words = self._words
        for name, place in places.items():
            words = [word.replace(f"{{{name}}}", str(place)) for word in words]
        finished = self._confined.run(words, case, out, self._started)
        written = out / "diagnosis.json"
        if finished.returncode or not written.exists():
            return f"exit code {finished.returncode}\n{finished.stdout[-2000:]}{finished.stderr[-2000:]}"
        try:
            return unreadable(json.loads(written.read_text(encoding="utf-8")))
        except (ValueError, RecursionError) as error:
            return f"diagnosis.json: expected JSON in UTF-8: {error}"
