"""The project's own file: one row a sample, SI units, a header that names the columns.

    time                        s; or in its place
    frame                       number of the frame, of a film of known frame rate
    <keypoint>_x,_y[,_z]        m; x right, y up in 2-D; z up in 3-D
    <keypoint>_likelihood       the tracker's confidence, optional; or _vis, _conf, _score, _prob
    <joint>_torque              N·m, the commanded torque, constant until the next row that has one; optional
    <joint>_angle               rad, Denavit–Hartenberg, from encoders; optional

An empty cell is missing. A row may carry a command and no keypoints: commands often run faster than cameras.
"""

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..naming import closest, nearest, some
from ..recording import Recording, check_time
from ..tables import read_header, read_table, write_table

AXES = ("x", "y", "z")
SUFFIXES = (*AXES, "likelihood", "torque", "angle")
TIME, FRAME = CLOCKS = ("time", "frame")  # columns of time, one of them in a file
OF_LOGS = ("position", "velocity", "effort", "target")  # endings of a robot's own columns
OF_TRACKERS = ("conf", "confidence", "vis", "visibility", "score", "prob", "probability")  # their words for likelihood


def read_keypoint_csv(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    fps: float | None = None,
) -> Recording:
    """Read one such file.

    Args:
        path: the file.
        joints: the names to expect and their order, from a body; by default those in the header.
        fps: frames a second, of a file with numbers of frames in place of times.

    Raises:
        InputError: a column that is unknown or missing, a time that does not increase, numbers of frames without
            `fps`, a cell that is not a number, a command whose first value is missing: the message names the row and
            column.
        OSError: a file that cannot be opened.
    """
    columns, where = read_table(path)
    with about(path):
        columns = _in_our_words(columns)
        found = _split(columns, joints or ())
        points = _distinct(stem for stem, suffix in found if suffix in AXES)
        in_file = _distinct(stem for stem, suffix in found if suffix in ("torque", "angle"))
        names = tuple(joints) if in_file and joints is not None else in_file
        if strange := [name for name in in_file if name not in names]:
            near = closest(strange[0], [name for name in names if name not in in_file])
            raise InputError(
                f"joints ({some(in_file)}) are not the body's ({some(names)}): unknown {strange[0]!r}{near}; "
                "rename them"
            )
        for stem in _distinct(stem for stem, suffix in found if suffix == "likelihood"):
            if stem not in points:
                raise InputError(f"column '{stem}_likelihood' belongs to no keypoint: there is no '{stem}_x'")
        axes = AXES if any(suffix == "z" for _, suffix in found) else AXES[:2]
        for missing in (f"{p}_{axis}" for p in points for axis in axes if f"{p}_{axis}" not in columns):
            raise InputError(f"column '{missing}' is missing: every keypoint needs {', '.join(axes)}")
        if FRAME in columns and fps is None:
            raise InputError("column 'frame' numbers the frames of a film: pass --fps, frames a second")
        time = columns[FRAME] / fps if fps is not None and FRAME in columns else columns[TIME]
        check_time(time, where)

        unknown = np.full(len(time), np.nan)

        def stack(stems: Sequence[str], suffix: str) -> np.ndarray:
            return np.stack([columns.get(f"{s}_{suffix}", unknown) for s in stems], axis=-1)

        def optional(stems: Sequence[str], suffix: str) -> np.ndarray | None:
            return stack(stems, suffix) if any(s == suffix for _, s in found) else None

        torques = optional(names, "torque")
        return Recording(
            time=time,
            keypoints=np.stack([stack(points, axis) for axis in axes], axis=-1)
            if points
            else np.empty((len(unknown), 0, 2)),
            keypoint_names=points,
            confidence=optional(points, "likelihood"),
            angles=optional(names, "angle"),
            torques=None if torques is None else _fill_forward(torques, names),
            joint_names=names,
            name=Path(path).stem,
        )


def numbers_frames(path: str | Path) -> bool:
    """Whether such a file numbers its frames and has no times. Raises as :func:`read_header`."""
    header = read_header(path)
    return FRAME in header and TIME not in header


def write_keypoint_csv(recording: Recording, path: str | Path) -> None:
    """Write such a file, whole or not at all; it reads back exactly.

    Raises:
        InputError: a recording whose lengths are not in metres.
        OSError: `path` cannot be written.
    """
    if recording.length_unit != "m":
        raise InputError(f"this file is in metres, the recording in {recording.length_unit}: scale it first")
    columns = {"time": recording.time}
    for p, point in enumerate(recording.keypoint_names):
        for axis, values in zip(AXES, recording.keypoints[:, p].T, strict=False):
            columns[f"{point}_{axis}"] = values
        if recording.confidence is not None:
            columns[f"{point}_likelihood"] = recording.confidence[:, p]
    for suffix, values in (("torque", recording.torques), ("angle", recording.angles)):
        if values is not None:
            columns |= {f"{joint}_{suffix}": values[:, k] for k, joint in enumerate(recording.joint_names)}
    write_table(columns, path)


def _in_our_words(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The same, with a tracker's word for a likelihood replaced; InputError for two of one keypoint."""
    found: dict[str, np.ndarray] = {}
    for column, values in columns.items():
        stem, _, end = column.rpartition("_")
        name = f"{stem}_likelihood" if stem and end.casefold() in OF_TRACKERS else column
        if name in found:
            raise InputError(f"expected one likelihood of {stem!r}, got two columns: leave out {column!r}")
        found[name] = values
    return found


def _split(columns: Iterable[str], joints: Sequence[str]) -> list[tuple[str, str]]:
    """Column names as (stem, suffix), the clock left out; InputError for one that is neither, and not one clock."""
    columns = list(columns)
    clocks = [clock for clock in CLOCKS if clock in columns]
    if not clocks:
        near = [close for clock in CLOCKS for close in difflib.get_close_matches(clock, map(str.lower, columns), 1)]
        hint = f": rename {next(c for c in columns if c.lower() == near[0])!r}?" if near else ""
        raise InputError(f"no column 'time', in seconds, nor 'frame', numbers of frames for --fps{hint}")
    if len(clocks) > 1:
        raise InputError("expected one column that says when, got 'time' and 'frame': leave one of them out")
    found = [(stem, end) for stem, _, end in (c.rpartition("_") for c in columns if c not in clocks)]
    for stem, suffix in found:
        column = f"{stem}_{suffix}" if stem else suffix
        if suffix in OF_LOGS:
            raise InputError(
                f"expected keypoints or angles, got the column {column!r} of a robot's log: pass --map, a file "
                f"that says which column is which joint's, or rename the columns to <joint>_angle and <joint>_torque"
            )
        if not stem or suffix not in SUFFIXES:
            stems = {s for s, _ in found if s} | {*joints}
            known = [*CLOCKS, *(f"{s}_{end}" for s in sorted(stems) for end in SUFFIXES)]
            whole = [name for name in known if name.startswith(column)]  # wrist_lik for wrist_likelihood
            near_one = whole[0] if whole else nearest(column, known)
            raise InputError(
                f"unknown column {column!r}{'' if near_one is None else f'; the closest known is {near_one!r}'} "
                f"(known are time, frame and <name>_{', _'.join(SUFFIXES)})"
            )
    return found


def _distinct(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _fill_forward(torques: np.ndarray, joints: Sequence[str]) -> np.ndarray:
    """(T, K), the last command above in each empty cell; a column that is all empty stays unknown."""
    filled = torques.copy()
    for k, joint in enumerate(joints):
        given = np.isfinite(filled[:, k])
        if given.any() and not given[0]:
            raise InputError(
                f"column '{joint}_torque' has no value in its first row: a command applies until the next, "
                "so the first row needs one (0 for a motor that is off)"
            )
        last = np.maximum.accumulate(np.where(given, np.arange(len(given)), 0))
        filled[:, k] = filled[last, k]
    return filled
