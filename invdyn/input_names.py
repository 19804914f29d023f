"""What stands on a command line, read before anything large is imported: names of bodies, ranges of frames, clocks."""

import math
from contextlib import AbstractContextManager
from importlib.resources import as_file, files
from pathlib import Path

from invdyn.recordings import InputError, check_readable, resolved
from invdyn.recordings.catalogue import check_exists


def body_file(name: str) -> AbstractContextManager[Path]:
    """The file of a body: one that is there, or one that comes with the package by its name.

    Raises FileNotFoundError for neither.
    """
    if resolved(name).exists():
        return as_file(check_readable(name))
    ours = {
        Path(file.name).stem: file for file in files("invdyn.models.bodies").iterdir() if file.name.endswith(".toml")
    }
    if name not in ours:
        raise FileNotFoundError(2, f"no such body file, nor one of ours ({', '.join(sorted(ours))})", name)
    return as_file(ours[name])


def check_exist(*recordings: str, body: str | None = None) -> None:
    """Raise FileNotFoundError for a file, or a name of ours, that is nowhere, before anything large is imported."""
    if body is not None:
        with body_file(body):
            pass
    for name in recordings:
        check_exists(name)


def frame_range(text: str) -> slice:
    """Rows of "50:250", "50:" or ":250". Raises InputError for anything else, and for no rows."""
    try:
        start, stop = (int(part) if part.strip() else None for part in text.split(":"))
    except ValueError:
        raise InputError(f"--frames is START:STOP, such as 50:250, got {text!r}") from None
    if start is not None and stop is not None and (start < 0) == (stop < 0) and start >= stop:
        raise InputError(f"--frames is START:STOP, the first row and the one after the last, got {text}: no rows")
    return slice(start, stop)


def camera_offset(text: str) -> tuple[str, float]:
    """Read "cam2=0.02". Raises InputError for anything else."""
    name, _, number = text.partition("=")
    try:
        seconds = float(number)
    except ValueError:
        seconds = math.nan
    if not (name and math.isfinite(seconds)):
        raise InputError(f"an offset is CAMERA=SECONDS, such as cam2=0.02, got {text!r}")
    return name, seconds
