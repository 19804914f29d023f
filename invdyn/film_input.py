"""A film: its joints are tracked into a table of pixels, which is a recording like any other."""

import hashlib
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from invdyn.models import Body
from invdyn.recordings import InputError
from invdyn.recordings.reading import Reading, TrackedFilm
from invdyn.recordings.tracking.film import Film

from .table_input import read_table

SIDES = ("left", "right")
"""Arms of a person, which are tracked without a network of one's own."""
Progress = Callable[[int, int, str], None]


def read_film(
    files: Sequence[str],
    body: Body,
    *,
    tracker: str | None = None,
    person: str | None = None,
    tracks: Path | None = None,
    checkpoint: Path | None = None,
    progress: Progress | None = None,
    frames: str = ":",
    guessed: bool = False,
    scale: float | str | None = None,
    base: str | None = None,
    as_filmed: bool = False,
) -> list[Reading]:
    """Track a film into the file ``tracks``, and read that.

    Raises InputError for a body in space, no scale, a keypoint of the body that is not tracked, and as tracker and
    reader do.
    """
    (name,) = files
    if tracks is None:
        raise InputError(f"{name}: a film has no keypoints yet: run `invdyn track`, and give its tracks")
    if body.dimensions != 2:
        raise InputError(
            f"{body.name}: a film of one camera takes a chain of hinges in the plane, this body moves in space"
        )
    if scale is None:
        raise InputError(
            f"{name}: a film has pixels, the body has metres: pass --scale with metres a pixel, or --scale body"
        )
    film = Film(Path(name))
    if film.aspect != 1:
        warnings.warn(
            f"{name}: its pixels are {film.aspect:.3g} times as wide as high, so no one scale fits both directions: "
            "make them square first, with ffmpeg's filter scale=iw*sar:ih,setsar=1",
            stacklevel=2,
        )
    root = base or body.joint_names[0]
    kept = None if checkpoint is None else checkpoint.with_name(f"{checkpoint.name}.tracking")
    track_into(tracks, film, tracker, person, kept, progress, (root, *body.keypoint_names))
    (reading,) = read_table(
        [str(tracks)], body, units="px", scale=scale, base=base, frames=frames, guessed=guessed, as_filmed=as_filmed
    )
    return [Reading(reading.recording, film=TrackedFilm(Path(name), tracks, root))]


def track_into(
    out: Path,
    film: Film,
    tracker: str | None,
    person: str | None,
    checkpoint: Path | None,
    progress: Progress | None,
    wanted: Sequence[str] | None = None,
) -> tuple[tuple[str, ...], Any]:
    """Track a film into a file of tracks; names of the keypoints, and (T, P, 3).

    Args:
        out: the file of tracks, .csv.
        film: the film.
        tracker: "left" or "right" for an arm of a person, or the file of a network.
        person: which of several people, for an arm.
        checkpoint: folder that keeps what is done.
        progress: called with (done, total, what).
        wanted: a base, which need not be tracked, and keypoints, which must be: no others are written.

    Raises InputError without a tracker, for a keypoint that is not tracked, and as film and tracker do.
    """
    from invdyn.recordings.tracking.blazepose import person_tracker
    from invdyn.recordings.tracking.heatmap import HeatmapTracker
    from invdyn.recordings.tracking.tracker import Tracker, track_film, write_tracks

    if tracker is None:
        raise InputError(
            f"{film.path}: what is to be tracked? give --tracker left or right for an arm of a person, or a network "
            "of `invdyn train`"
        )
    if person is not None and tracker not in SIDES:
        raise InputError("person says whose arm --tracker left or right tracks: leave it out with a network")
    found: Tracker
    run: dict[str, Any] = {"arm": None, "person": person}
    if tracker in SIDES:
        run["arm"] = tracker
        found = person_tracker(tracker, person, progress)
    else:
        found = HeatmapTracker.load(Path(tracker))
    names = found.keypoint_names
    if wanted is not None:
        if missing := [name for name in wanted[1:] if name not in names]:
            raise InputError(
                f"the body's keypoint {missing[0]!r} is not tracked; tracked are {', '.join(names)}: rename one of them"
            )
        names = tuple(name for name in wanted if name in names)
    keeper = None
    if checkpoint is not None:
        from invdyn.inference.execution.checkpoint import Checkpoint

        with film.path.open("rb") as file:
            run["film"] = hashlib.file_digest(file, "sha256").hexdigest()
        if run["arm"] is None:
            run["network"] = hashlib.sha256(Path(tracker).read_bytes()).hexdigest()
        keeper = Checkpoint(checkpoint, run, "track")
    times, tracks = track_film(film, found, progress, keeper)
    tracks = tracks[:, [found.keypoint_names.index(name) for name in names]]
    write_tracks(names, times, tracks, out)
    return names, tracks
