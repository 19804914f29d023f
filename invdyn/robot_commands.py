"""The commands of robots' own logs: `invdyn check`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from .console import BAD_INPUT, check_ending, check_outputs, say


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(check)


def check(
    robot: Annotated[str, typer.Argument(help="Robot: .xml (MJCF), .urdf, .toml, or one that comes with us.")],
    log: Annotated[str, typer.Argument(help="Its log: .csv, .mcap, a ROS 2 bag or a LeRobot data set.")],
    units: Annotated[str | None, typer.Option(help="Of the file, if not SI: deg, ms, us …")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames a second, if the log has no times.")] = None,
    frames: Annotated[str, typer.Option(help="Which rows, such as 50:250.")] = ":",
    mapping: Annotated[
        str | None, typer.Option("--map", metavar="FILE", help="Which track of the log is which joint's: .toml.")
    ] = None,
    episode: Annotated[int, typer.Option(min=0, help="Which, in a log of several.")] = 0,
    passive: Annotated[bool, typer.Option("--passive", help="No torque acts.")] = False,
    effects: Annotated[bool, typer.Option("--effects/--no-effects", help="Say which effects it could show.")] = True,
    out: Annotated[Path | None, typer.Option(help="The same as a file: .json.")] = None,
) -> None:
    """Check a log before a diagnosis: signs, zeros, units, columns, gears; what it excites, and what it can show.

    Exit code 2 where something is to be put right.
    """
    from invdyn.diagnosis.check.check import check as run
    from invdyn.recordings import write_text

    from .check_text import check_text
    from .inputs import is_log, load_body, read_as_it_stands

    check_outputs([out], [Path(robot), Path(log)])
    check_ending("a check", out, ".json")
    body = load_body(robot, filmed=not is_log(log, mapping))
    reading = read_as_it_stands(log, body, units, frames, mapping, episode, fps)
    found = run(reading, body, passive=passive, effects=effects)
    if out is not None:
        write_text(out, json.dumps(found.to_json(), indent=1, ensure_ascii=False) + "\n")
    say(check_text(found))
    if out is not None:
        say(f"JSON       {out}")
    if found.mistakes:
        raise typer.Exit(BAD_INPUT)
