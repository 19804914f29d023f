"""The commands of robots' own logs: `invdyn check`."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import BAD_INPUT, check_ending, check_outputs, say
from .options import FrameRate, Frames, Mapping, Units, ZeroTorque
from .settings import Setting, with_settings


def register(command: Callable[..., Any]) -> None:
    """Add the command."""
    command()(with_settings(check))


def check(
    robot: Annotated[str, typer.Argument(help="Robot: .xml (MJCF), .urdf, .toml, or one that comes with us.")],
    log: Annotated[str, typer.Argument(help="Its log: .csv, .mcap, a ROS 2 bag or a LeRobot data set.")],
    units: Units = None,
    fps: FrameRate = None,
    frames: Frames = ":",
    mapping: Mapping = None,
    zero_torque: ZeroTorque = False,
    effects: Annotated[bool, typer.Option("--effects/--no-effects", help="Say which effects it could show.")] = True,
    out: Annotated[Path | None, typer.Option(help="The same as a file: .json.")] = None,
    episodes: Annotated[str, Setting("which episode of a log of several; default: the first")] = "0",
) -> None:
    """Check a log before a diagnosis, and say what it can show.

    Signs, zeros, units, columns and gears; what it excites. Exit code 2 where
    something is to be put right.
    """
    from .input_names import check_exist

    check_exist(log, body=robot)

    from invdyn.diagnosis.check.check import check as run
    from invdyn.recordings import InputError, write_text

    from .check_text import check_text
    from .inputs import LOG, TABLE, check_options, load_body, read_recordings, source_of

    check_outputs([out], [Path(robot), Path(log)])
    check_ending("a check", out, ".json")
    source = source_of([log], None, mapping)
    given = {"units": units, "fps": fps, "mapping": mapping, "episodes": None if episodes == "0" else episodes}
    check_options(log, [source], given)
    shown: dict[str, Any] = {"recording": log, "units": units, "fps": fps} if source is TABLE else {}
    body = load_body(robot, filmed=source is not LOG, **shown)
    readings = read_recordings([log], body, **given, frames=frames, as_it_stands=True)
    if len(readings) > 1:
        raise InputError(f"expected one episode to check, got {len(readings)}")
    found = run(readings[0], body, passive=zero_torque, effects=effects)
    if out is not None:
        write_text(out, json.dumps(found.to_json(), indent=1, ensure_ascii=False) + "\n")
    say(check_text(found))
    if out is not None:
        say(f"JSON       {out}")
    if found.mistakes:
        raise typer.Exit(BAD_INPUT)
