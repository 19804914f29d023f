"""The table of a study's trials, one a row:

    recording    files of the trial, relative to the table; of several cameras with ";" between them
    trial        its name; default: the recording
    subject, session    default: 1
    condition, factor_<name>    what differs between trials
    event_<name>     time of an event, s, by the recording's clock; empty where it did not happen
    events           a file of events with a clock of its own: columns event and time (s)
    clock_offset     that clock's time where the recording's is 0, s; default: 0
    body, or height (m), mass (kg) and sex      in place of those of the command
    fps, units, scale, base, individual, frames     in place of those of the command
    note             not read

A folder stands for a table of its files, each folder in it a session.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .inference_options import Inference

if TYPE_CHECKING:
    from invdyn.inference.study.trial import Trial
    from invdyn.models import Body

EVENT, FACTOR = "event_", "factor_"
SUFFIXES = (".csv", ".h5", ".hdf5", ".slp", ".nwb", ".trc", ".mot")
"""Of files of a folder that are taken for recordings."""
OF_BODY = ("body", "height", "mass", "sex")
OF_READING = ("fps", "units", "scale", "base", "individual", "frames")
KNOWN = ("recording", "trial", "subject", "session", "condition", "events", "clock_offset", "note")
NUMBERS = ("height", "mass", "fps")


@dataclass(frozen=True)
class ManyTrials(Inference):
    """What `trials` is given: a table or a folder of recordings, and what `infer` is given of each."""

    recordings: Annotated[
        list[str],
        typer.Argument(
            metavar="TABLE",
            help="Table of trials, .csv: recording, subject, session, condition, event_…; or a folder of recordings.",
        ),
    ]


def read_rows(given: Inference) -> list[dict[str, str]]:
    """Rows of the table, or of a folder's files. Raises InputError or OSError."""
    from invdyn.recordings import InputError
    from invdyn.recordings.errors import about
    from invdyn.recordings.tables import check_once, header_and_rows

    if len(given.recordings) != 1:
        raise InputError(f"expected one table or folder, got {len(given.recordings)}")
    path = Path(given.recording)
    if path.is_dir():
        files = sorted(file for file in path.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file())
        if not files:
            raise InputError(f"{path}: expected recordings in this folder, found none ({', '.join(SUFFIXES)})")
        names = [file.relative_to(path) for file in files]
        own = zip(files, names, strict=True)
        return [{"recording": str(file), "trial": str(name), "session": str(name.parent)} for file, name in own]
    header, lines = header_and_rows(path)
    with about(path):
        check_once(header, [name for name in header if name])
    rows = []
    for line, cells in lines:
        if any(cells[len(header) :]):
            what = f"{len(header)} cells, got {len(cells)}: put a cell that has a comma between quotes"
            raise InputError(f"{path}: line {line}: expected {what}")
        if any(cells):
            rows.append({name: cell for name, cell in zip_longest(header, cells, fillvalue="") if name})
    return checked(rows, str(path), path.parent)


def checked(rows: list[dict[str, Any]], name: str, folder: Path = Path()) -> list[dict[str, str]]:
    """Rows with files relative to the table's folder. Raises InputError for columns that are not known."""
    from invdyn.recordings import InputError
    from invdyn.recordings.naming import closest

    if not rows:
        raise InputError(f"{name}: expected one trial a row, got none")
    known = (*KNOWN, *OF_BODY, *OF_READING)
    if "recording" not in rows[0]:
        raise InputError(f"{name}: expected a column recording, got {', '.join(rows[0])}")
    if strange := [each for each in rows[0] if each not in known and not each.startswith((EVENT, FACTOR))]:
        raise InputError(
            f"{name}: column {strange[0]!r} is not known{closest(strange[0], known)}: call a factor "
            f"{FACTOR}{strange[0]}, an event {EVENT}{strange[0]}, a remark note"
        )
    if "condition" in rows[0] and f"{FACTOR}condition" in rows[0]:
        raise InputError(f"{name}: expected one column of the condition, got condition and {FACTOR}condition")
    for row in rows:
        row["trial"] = row.get("trial") or row["recording"]
        row.update({key: "" for key, value in row.items() if value in ("nan", "NaN")})
        if row["recording"]:
            parts = row["recording"].split(";")
            row["recording"] = ";".join(_placed(part.strip(), folder) for part in parts)
        for key in ("body", "events"):
            if row.get(key):
                row[key] = _placed(row[key], folder)
    return rows


def _placed(name: str, folder: Path) -> str:
    """A file next to the table, if it is there; else the name, which may be that of one of ours."""
    return str(folder / name) if (folder / name).exists() else name


def read_trials(
    rows: Sequence[Mapping[str, str]],
    given: Inference,
    body: "Body | None",
    progress: Callable[[int, int, str], None] | None = None,
) -> "list[Trial]":
    """Trials of the rows; one that cannot be read says why.

    Raises InputError for a time that is none, or an events' file that cannot be read.
    """
    from invdyn.inference.study.trial import Trial
    from invdyn.models import BodyError
    from invdyn.recordings import InputError
    from invdyn.recordings.errors import first_line

    factors = [name for name in rows[0] if name == "condition" or name.startswith(FACTOR)] or ["condition"]
    found = []
    for number, row in enumerate(rows):
        recording, own, unread = None, body, ""
        try:
            recording, own = _read(row, given, body)
        except (InputError, BodyError, OSError) as error:
            unread = first_line(error)
        labels = {name.removeprefix(FACTOR): row.get(name, "") if name in row else "all" for name in factors}
        name = row["trial"] or f"row {number + 1}"
        where = row.get("subject") or "1", row.get("session") or "1"
        found.append(Trial(name, recording, own, *where, labels, _events(row, recording), unread))
        if progress is not None:
            progress(number + 1, len(rows), "read")
    return found


def _read(row: Mapping[str, str], given: Inference, body: "Body | None") -> tuple[Any, Any]:
    """Recording and body of a row. Raises InputError, BodyError or OSError."""
    from invdyn.recordings import InputError

    from .inputs import read_recordings

    stated = {name: row[name] for name in (*OF_BODY, *OF_READING) if row.get(name)}
    values: dict[str, Any] = {name: _number(name, text) if name in NUMBERS else text for name, text in stated.items()}
    files = [part for part in row["recording"].split(";") if part]
    if not files:
        raise InputError("no recording is named")
    if {*OF_BODY} & {*values}:  # a row says all of its body
        body = None
        values = {**dict.fromkeys(OF_BODY), **values}
    own = replace(given, recordings=files, **values)
    if body is not None:
        more = {"frames": own.frames, "guessed": "lengths" in own.learned, "hide_torque": own.hide_torque}
        readings = read_recordings(files, body, **own.reading, **more)
        return readings[0].recording, body
    own.check_exist()
    read, _ = own.load()
    return read["recording"], read["body"]


def _events(row: Mapping[str, str], recording: Any) -> dict[str, float]:
    """Times of events by the recording's clock, NaN where they did not happen."""
    from invdyn.recordings import InputError
    from invdyn.recordings.tables import header_and_rows

    times = {name.removeprefix(EVENT): _number(name, text) for name, text in row.items() if name.startswith(EVENT)}
    if row.get("events") and recording is not None:
        header, rows = header_and_rows(row["events"])
        lines = [[*cells, *[""] * len(header)] for _, cells in rows]  # a line may end early
        if not {"event", "time"} <= {*header}:
            raise InputError(f"{row['events']}: expected columns event and time, got {', '.join(header)}")
        offset = _number("clock_offset", row.get("clock_offset") or "0")
        for cells in lines:
            event, time = cells[header.index("event")], _number("time", cells[header.index("time")]) - offset
            within = recording.time[0] <= time <= recording.time[-1]
            times.setdefault(event, math.nan)
            if within and math.isnan(times[event]):  # of several the first
                times[event] = time
    return times


def _number(name: str, text: str) -> float:
    from invdyn.recordings import InputError
    from invdyn.recordings.tables import number_of

    try:
        value = number_of(text)
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise InputError(f"{name}: expected a number, got {text!r}")
    return value
