"""The command of robots' own logs, `invdyn check`, and what it prints."""

import json
from collections.abc import Iterable
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .console import BAD_INPUT, check_ending, check_outputs, say
from .options import FrameRate, Frames, Mapping, Units, ZeroTorque
from .settings import Setting

if TYPE_CHECKING:
    from invdyn.diagnosis.check.check import Check


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

    from .inputs import LOG, TABLE, check_options, load_body, read_recordings, source_of
    from .recording_options import Recorded

    check_outputs([out], [Path(robot), Path(log)])
    check_ending("a check", out, ".json")
    source = source_of([log], None, mapping)
    given = {"units": units, "fps": fps, "mapping": mapping, "episodes": None if episodes == "0" else episodes}
    check_options(log, [source], given, Recorded)
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


WIDTH, INDENT = 100, " " * 11
"""Columns of a line, and of its continuation."""
MAX_KNOWN_SD, MAX_LISTED = 0.2, 8
"""Relative sd under which a number is known, and how many of a kind are listed."""


def check_text(found: "Check") -> str:
    """Mistakes first; then what the torques leave, what is excited, what would show, and what to record."""
    lines = [f"wrong      {wrong.sentence}" for wrong in found.mistakes]
    if found.unclear:
        lines = ["unclear    the torques are far from the motion, and no sign, zero, unit, column or gear explains it"]
        if found.nearest is not None and found.nearest.after < found.rules.check.max_right_misfit:
            lines.append(f"nearest    {found.nearest.sentence}")
    elif not lines:
        lines = ["right      nothing looks wrong" + (" in what could be looked at" if found.not_looked_at else "")]
        most = found.rules.check.max_right_misfit
        if odd := [joint for joint, share in found.by_joint.items() if share > most]:
            lines[0] += f", and yet {100 * most:.0f} % or more of the torques is not explained at {', '.join(odd)}"
    if found.doubt is not None:
        lines.append(f"doubt      {found.doubt}")
    if found.not_looked_at is not None:
        lines.append(f"not seen   {found.not_looked_at}")
    if found.unexplained is not None:
        parts = ", ".join(f"{joint} {100 * share:.0f} %" for joint, share in found.by_joint.items())
        lines.append(f"torques    what the body and friction leave of their size: {parts}")
    if found.excited:
        known = [each for each in found.excited if each.value and each.sd < MAX_KNOWN_SD * abs(each.value)]
        weak = [each for each in found.excited if each not in known and each.value]
        lines += [f"excited    {e.words}: to {100 * e.sd / abs(e.value):.2g} %" for e in known[:MAX_LISTED]]
        lines += [f"weak       {e.words}: no better than {100 * e.sd / abs(e.value):.0f} %" for e in weak[:MAX_LISTED]]
    if (shown := found.visible) is not None:
        names = [name for name in shown.dprime if name not in shown.hidden]
        long = [f"would show {len(names)} effects of {len(shown.dprime)}: {_by_effect(names) or 'none'}"]
        long += [f"hidden     {_by_effect(of)}: record {what}" for what, of in shown.record.items()]
        lines += [fill(line, WIDTH, subsequent_indent=INDENT, break_long_words=False) for line in long]
    return "\n".join(lines)


def _by_effect(keys: Iterable[str]) -> str:
    """Each effect once, with its places: "payload (upper_arm, forearm), gravity_tilt"."""
    places: dict[str, list[str]] = {}
    for key in keys:
        effect, _, place = key.partition(".")
        places.setdefault(effect, []).extend([place] if place else [])
    return ", ".join(f"{effect} ({', '.join(at)})" if at else effect for effect, at in places.items())
