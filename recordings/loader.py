"""One call from a file, or the name of a known recording, to a checked Recording in SI units."""

import difflib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from . import catalogue
from .errors import InputError, about
from .formats import FORMATS, recognise
from .keypoint_csv import read_keypoint_csv
from .paths import check_readable, resolved
from .recording import Recording
from .units import check_magnitudes, parse_units, to_si

SLOWEST, FASTEST = 1e-3, 1e6  # frames a second


def load(
    path_or_name: str | Path,
    *,
    units: str | None = None,
    fps: float | None = None,
    keypoints: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    format: str | None = None,
    base: str | None = None,
    scale: float | None = None,
    individual: str | None = None,
) -> Recording:
    """Read a recording.

    Args:
        path_or_name: a file, or a name of `catalogue.names()`.
        units: a comma-separated list such as "px" or "mm,deg"; what the numbers in the file are. Only the
            project's own CSV (metres, radians) and files that carry their units go without.
        fps: frames a second, for files without times.
        keypoints: the names to keep and their order, from a body; the default keeps all. The project's own
            CSV may hold no others; other files may.
        joints: likewise, of angles and commands.
        format: a key of `formats.FORMATS`; by default it is recognised.
        base: the keypoint at the first joint. Where the file has it, all others are taken relative to it,
            frame by frame, and it is dropped if `keypoints` leaves it out. A fixed base need not be tracked.
        scale: metres a pixel; without it, pixels stay pixels (`length_unit` "px", y up).
        individual: which animal, in files of several.

    Returns:
        Recording, lengths in m (or "px"), angles in rad, missing values NaN.

    Raises:
        InputError: whatever is wrong with the file or does not fit these options, in one line.
        OSError: a file that cannot be opened.
    """
    path = Path(path_or_name)
    resolved(path)
    if not path.exists() and str(path_or_name) in catalogue.names():
        given = {"units": units, "fps": fps, "format": format, "scale": scale, "individual": individual}
        if surplus := [f"--{option}" for option, value in given.items() if value is not None]:
            raise InputError(f"{path_or_name} has known units and times: leave {', '.join(surplus)} out")
        recording = catalogue.load_named(str(path_or_name))
    else:
        if not path.exists():
            raise FileNotFoundError(*_no_such_file(path))
        recording = _read(path, units, fps, keypoints, joints, format, base, scale, individual)
    with about(path_or_name):
        recording = _keep(recording, keypoints, joints, base)
        for p, name in enumerate(recording.keypoint_names):
            if not np.isfinite(recording.keypoints[:, p]).all(axis=-1).any():
                raise InputError(f"keypoint {name!r} is missing in every frame")
        return recording


def _read(path, units, fps, keypoints, joints, format, base, scale, individual) -> Recording:
    check_readable(path)
    kind = recognise(path, format)
    form = FORMATS[kind]
    with about(path):
        declared = parse_units(units)
        if form.own_times and fps is not None:
            raise InputError(f"a {form.title} file carries its own times: leave --fps out")
        if not form.own_units and declared.length is None:
            raise InputError(f"a {form.title} file does not say its units: pass --units px (or mm, cm, m)")
        if not form.own_times and fps is None:
            raise InputError(f"a {form.title} file does not say its frame rate: pass --fps, frames a second")
        if fps is not None and not SLOWEST <= fps <= FASTEST:
            raise InputError(f"--fps must be positive, from {SLOWEST:g} to {FASTEST:g} frames a second, got {fps:g}")
        if kind == "trc" and units is not None:
            raise InputError(f"a {form.title} file carries its own units: leave --units out")
        if form.read is None:
            recording = read_keypoint_csv(path, keypoints=keypoints, joints=joints, base=base)
        else:
            recording = form.read(path, fps, individual)
        recording = to_si(recording, declared, scale)
        check_magnitudes(recording, declared)
        return recording


def _keep(
    recording: Recording, keypoints: Sequence[str] | None, joints: Sequence[str] | None, base: str | None
) -> Recording:
    """Take the base away, then the named keypoints and joints in their order."""
    if base in recording.keypoint_names:
        recording = recording.relative_to(base)
    if keypoints is not None and recording.keypoint_names:
        order = [_index("keypoint", name, recording.keypoint_names) for name in keypoints]
        confidence = recording.confidence
        recording = replace(
            recording,
            keypoints=recording.keypoints[:, order],
            keypoint_names=tuple(keypoints),
            confidence=None if confidence is None else confidence[:, order],
        )
    if joints is not None and recording.joint_names:
        order = [_index("joint", name, recording.joint_names) for name in joints]
        recording = replace(
            recording,
            joint_names=tuple(joints),
            angles=None if recording.angles is None else recording.angles[:, order],
            torques=None if recording.torques is None else recording.torques[:, order],
        )
    return recording


def _index(kind: str, name: str, known: Sequence[str]) -> int:
    if name not in known:
        near = difflib.get_close_matches(name, known, 1, cutoff=0.0)[0]
        raise InputError(f"{kind} {name!r} is missing: the file has {', '.join(known)} (closest: {near!r})")
    return list(known).index(name)


def _no_such_file(path: Path) -> tuple[int, str, str]:
    import errno

    near = difflib.get_close_matches(str(path), catalogue.names(), 1, cutoff=0.7)
    hint = f", nor a recording of that name; did you mean {near[0]!r}?" if near else ""
    return errno.ENOENT, f"no such file{hint}", str(path)
