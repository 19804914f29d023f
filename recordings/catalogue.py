"""Real recordings by name; catalogue.csv pins their files by commit and hash.

human-arm    DeepLabCut on a human arm seen from above, 30 frames/s: shoulder, elbow, wrist. No scale is
             known: it stays in pixels (`in_body_lengths` divides by the arm's length). Its publication shows
             frames 50–250.
dfki-…       a two-joint arm with encoders and motors, links .3 and .2 m (BSD-3-Clause)
  trajectory-NN    excitation, with commanded and measured torque
  20220812-HHMMSS  excitation on another day; the torque is the command, none was measured
  swing-up         the controlled swing-up, and film: its first 5 s at 30 frames/s, elbow and a disc as wrist
  static           nothing commanded: the noise of encoders and torque sensors
ibm-N        a passive toy double pendulum, 400 frames/s: its commanded torque is zero (CDLA-Sharing-1.0)
"""

import csv
import difflib
import errno
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from .errors import InputError
from .public_recordings import read_dfki, read_dfki_film, read_human_arm, read_ibm
from .recording import Recording
from .sources import Source, fetch
from .truth import Truth


@dataclass(frozen=True)
class Named:
    """An entry: its files, the function that reads them, and the frames of a published demonstration."""

    sources: tuple[Source, ...]
    read: Callable[..., tuple[Recording, Truth | None]]
    demo_frames: tuple[int, int] | None = None


def names() -> tuple[str, ...]:
    """All names, in order."""
    return tuple(CATALOGUE)


def check_exists(path_or_name: str | Path) -> None:
    """Raise FileNotFoundError for what is no file, and no name of `names()`."""
    path, known = Path(path_or_name), names()
    if path.exists() or str(path_or_name) in known:
        return
    near = difflib.get_close_matches(str(path), known, 1, cutoff=0.7)
    hint = f", nor a recording of that name; did you mean {near[0]!r}?" if near else ""
    raise FileNotFoundError(errno.ENOENT, f"no such file{hint}", str(path))


def demo_frames(name: str) -> slice:
    """The frames of a published demonstration, or all. Raises InputError for an unknown name."""
    return slice(*(_entry(name).demo_frames or (None, None)))


def load_named(name: str) -> Recording:
    """The recording of that name: m (human-arm: px, y up), s, rad, N·m.

    Raises InputError for an unknown name, or when its files cannot be had.
    """
    return _load(name)[0]


def load_truth(name: str) -> Truth:
    """Measured angles, velocities and motor torques of a robot's recording, at the recording's times.

    The torque is NaN where none was measured. Raises InputError for a recording without encoders.
    """
    truth = _load(name)[1]
    if truth is None:
        raise InputError(f"{name} carries no measured truth; the recordings named dfki-… do")
    return truth


def _entry(name: str) -> Named:
    if name not in CATALOGUE:
        raise InputError(f"no recording is named {name!r}; known are {', '.join(CATALOGUE)}")
    return CATALOGUE[name]


def _load(name: str) -> tuple[Recording, Truth | None]:
    entry = _entry(name)
    recording, truth = entry.read(*(fetch(source) for source in entry.sources))
    return replace(recording, name=name), truth


def _read_catalogue() -> dict[str, Named]:
    """Entries of catalogue.csv, which has one row for each file."""
    readers = {each.__name__: each for each in (read_dfki, read_dfki_film, read_human_arm, read_ibm)}
    found: dict[str, Named] = {}
    with Path(__file__).with_name("catalogue.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            earlier = found[row["name"]].sources if row["name"] in found else ()
            place = row["file"], row["repository"], row["commit"], row["path"], row["sha256"]
            source = Source(*place, row["rounded"] == "yes")
            found[row["name"]] = Named((*earlier, source), readers[row["reader"]], DEMO_FRAMES.get(row["name"]))
    return found


DEMO_FRAMES = {"human-arm": (50, 250)}
CATALOGUE = _read_catalogue()
