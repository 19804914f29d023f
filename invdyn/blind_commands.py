"""The blind check of a diagnosis: `invdyn blind`."""

from pathlib import Path
from typing import Annotated

import typer

from .console import ProgressBar, say
from .options import MOST_WORKERS


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(blind)


def blind(
    out: Annotated[Path, typer.Option(help="Folder for all of it; the same call again goes on from there.")],
    cases: Annotated[int, typer.Option(min=1, help="How many, over the kinds.")] = 60,
    kinds: Annotated[
        str | None,
        typer.Option(help="Such as commanded,none or commanded=200,none=40; default: all, four in ten commanded."),
    ] = None,
    seed: Annotated[
        str | None,
        typer.Option(help="Cases follow from it; a number, or - to be asked for it. Default: 1000000, for a look."),
    ] = None,
    seed_file: Annotated[
        Path | None,
        typer.Option(help="File with the seed; other processes can read a command line, but not a private file."),
    ] = None,
    workers: Annotated[int, typer.Option(min=1, max=MOST_WORKERS, help="Processes.")] = 2,
    engine: Annotated[
        str, typer.Option(help="What plays reality: mujoco or pinocchio, each with forms of effects of its own.")
    ] = "mujoco",
    bodies: Annotated[
        str, typer.Option(help="plane: chains of one to three links; space: trees of three to seven hinges, by mujoco.")
    ] = "plane",
    method_command: Annotated[
        str | None,
        typer.Option(help="Another method: a command with {recording}, {body}, {out}; see docs/blind_protocol.md."),
    ] = None,
    method_user: Annotated[str | None, typer.Option(help="Run that method as this user; needs root.")] = None,
    confine: Annotated[
        bool,
        typer.Option("--confine/--no-confine", help="Run that method in a container of bubblewrap, if it works here."),
    ] = True,
    oracle: Annotated[
        bool, typer.Option("--oracle", help="Diagnose again with the true effects told: how far could the gap close?")
    ] = False,
) -> None:
    """Play reality in another engine, withhold which effects are in it, diagnose, and score the answers."""
    from invdyn.blindcheck.confined import confined
    from invdyn.blindcheck.counts import counted
    from invdyn.blindcheck.run import BlindRun
    from invdyn.recordings import InputError

    from .seeds import secret_seed

    if method_user is not None and method_command is None:
        raise InputError("--method-user: expected --method-command with it; our own method runs as you do")
    if bodies not in ("plane", "space") or (bodies == "space" and engine != "mujoco"):
        raise InputError(f"--bodies: expected plane, or space with mujoco, got {bodies!r} with {engine}")
    played = engine if bodies == "plane" else f"{engine}-in-space"
    counts = counted(kinds, cases)
    number, hidden = secret_seed(seed, seed_file, 1_000_000)
    keeps = confined(method_user, confine and method_command is not None, [p for p in (out, seed_file) if p])
    run = BlindRun(out, counts, number, workers, method_command, keeps, played)
    run.check()
    if method_command is not None:
        say(keeps.described())
        if not hidden:
            typer.echo(
                "warning: the seed stands on the command line, or is the default, and tells a method all answers; "
                "for a run that counts give --seed-file or --seed -",
                err=True,
            )
    with ProgressBar() as progress:
        commitment = run.make(progress)
    say(f"sealed answers, SHA-256 {commitment}")
    with ProgressBar() as progress:
        run.diagnose(progress)
        scores = run.score(progress, oracle=oracle)
    say(scores.text())
    say(run.listing())
