"""The blind check of a diagnosis, `invdyn blind`; its seed may be hidden from other processes."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from .console import ProgressBar, print_line, say
from .options import Processes
from .settings import Setting, yes


def blind(
    out: Annotated[Path, typer.Option(help="Folder for all of it; the same call again continues there.")],
    cases: Annotated[int, typer.Option(min=1, help="How many, over the kinds.")] = 60,
    kinds: Annotated[
        str | None,
        typer.Option(help="Such as commanded,none or commanded=200,none=40; default: all, 40 % of them commanded."),
    ] = None,
    seed: Annotated[
        str | None,
        typer.Option(
            help="Cases follow from it; a number, or - to be prompted for it. Default: 1000000, for a first look."
        ),
    ] = None,
    seed_file: Annotated[
        Path | None,
        typer.Option(help="File with the seed: other processes can read a command line, but not a private file."),
    ] = None,
    workers: Processes = 2,
    engine: Annotated[
        str, typer.Option(help="What simulates reality: mujoco or pinocchio, each with its own forms of effects.")
    ] = "mujoco",
    bodies: Annotated[
        str,
        Setting("plane: chains of one to three links (the default); space: trees of three to seven hinges, by mujoco"),
    ] = "plane",
    method_command: Annotated[
        str | None,
        typer.Option(help="Another method: a command with {recording}, {body}, {out}; see docs/blind_protocol.md."),
    ] = None,
    confine: Annotated[
        bool, Setting("no: run that method outside of bubblewrap's container; default: yes, if it works here", yes)
    ] = True,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Diagnose again, given the true effects: how far could the gap close?")
    ] = False,
    method_user: Annotated[str | None, Setting("run that method as this user; needs root")] = None,
) -> None:
    """Score diagnoses of realities whose effects are withheld.

    Another engine simulates reality; which effects are in it is withheld from
    the diagnosis, and its answers are scored.
    """
    from invdyn.blindcheck.confined import confined
    from invdyn.blindcheck.kinds import counted
    from invdyn.blindcheck.run import BlindRun
    from invdyn.recordings import InputError

    if method_user is not None and method_command is None:
        raise InputError("method_user: expected --method-command with it; our own method runs as you do")
    if bodies not in ("plane", "space") or (bodies == "space" and engine != "mujoco"):
        raise InputError(f"--set bodies: expected plane, or space with mujoco, got {bodies!r} with {engine}")
    world = engine if bodies == "plane" else f"{engine}-in-space"
    counts = counted(kinds, cases)
    number, hidden = secret_seed(seed, seed_file, 1_000_000)
    keeps = confined(method_user, confine and method_command is not None, [p for p in (out, seed_file) if p])
    run = BlindRun(out, counts, number, workers, method_command, keeps, world)
    run.check()
    if method_command is not None:
        say(keeps.described())
        if not hidden:
            print_line(
                "warning",
                "the seed stands on the command line, or is the default, and gives a method all answers; "
                "for a run that counts give --seed-file or --seed -",
            )
    with ProgressBar() as progress:
        commitment = run.make(progress)
    say(f"sealed answers, SHA-256 {commitment}")
    with ProgressBar() as progress:
        run.diagnose(progress)
        scores = run.score(progress, oracle=oracle)
    say(scores.text())
    say(run.listing())


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
