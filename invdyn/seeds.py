"""A seed that other processes cannot read: from a file or a prompt, instead of the command line."""

import sys
from pathlib import Path

import typer

MAX_FIRST_SEED = 2**63 - 2**20
"""Seeds of a run's cases lie behind its own."""


def secret_seed(given: str | None, file: Path | None, default: int) -> tuple[int, bool]:
    """A run's seed, and whether it is on no command line: `given` is a number, or "-" for a prompt.

    A prompt at a terminal does not show it; otherwise it is the first line of standard input. Raises InputError for
    both ways at once and for what is no seed, OSError for a file that cannot be read.
    """
    from invdyn.recordings import InputError, resolved

    if given is not None and file is not None:
        raise InputError("--seed and --seed-file: expected one of them, got both")
    if file is not None:
        with open(resolved(file), encoding="utf-8", errors="replace") as lines:
            return _seed(lines.read(1000), str(file)), True
    if given == "-":
        if sys.stdin.isatty():
            return _seed(typer.prompt("Seed", hide_input=True), "the seed"), True
        return _seed(sys.stdin.readline(1000), "standard input"), True
    return (default if given is None else _seed(given, "--seed")), False


def _seed(text: str, where: str) -> int:
    from invdyn.recordings import InputError

    text = text.strip()
    if not text.isascii() or not text.isdigit() or len(text) > 19 or int(text) > MAX_FIRST_SEED:
        # what came is not repeated: it may be the seed but for a slip
        raise InputError(f"{where}: expected a seed, one whole number from 0 to {MAX_FIRST_SEED}, got something else")
    return int(text)
