"""One call from a file, or the name of a known recording, to a checked Recording in SI units."""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from . import catalogue
from .errors import InputError, about
from .formats.keypoint_csv import numbers_frames, read_keypoint_csv
from .formats.registry import FORMATS, Format, recognise
from .naming import closest, of_one_side, same_letters, some
from .paths import check_readable, resolved
from .plane import FLAT, planar, read_as
from .plausible import check_magnitudes
from .recording import Recording
from .repairs import repaired
from .si import to_si
from .units import FRAMES, Units, parse_units
from .zero_likelihood import without_zeros

MIN_RATE, MAX_RATE = 1e-3, 1e6  # frames a second


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
    plane: str | None = None,
    shifting: Collection[str] = (),
) -> Recording:
    """Read a recording.

    Args:
        path_or_name: a file, or a name of `catalogue.names()`.
        units: a comma-separated list such as "px" or "mm,deg"; what the numbers in the file are. Only the
            project's own CSV (metres, radians) and files that carry their units go without.
        fps: frames a second, for files without times and for numbers of frames.
        keypoints: the names to keep and their order, from a body; the default keeps all.
        joints: likewise, of angles and commands.
        format: a key of `formats.FORMATS`; by default it is recognised.
        base: the keypoint at the first joint. Where the file has it, all are moved by one constant, so that the
            middle of its track is the origin, and it is kept, as the first one if `keypoints` leaves it out. A base
            that stands still need not be tracked.
        scale: metres a pixel; without it, pixels stay pixels (`length_unit` "px", y up).
        individual: which animal, in files of several.
        plane: two of the file's axes, such as "xz", of three coordinates; "flat" for those that are left without a
            constant one; None keeps three.
        shifting: joints of a body that shift; a file in degrees has their positions in m.

    Returns:
        Recording, lengths in m (or "px"), angles in rad, missing values NaN.

    Raises:
        InputError: what is wrong with the file, or does not fit these options, in one line.
        OSError: a file that cannot be opened.
    """
    path = Path(path_or_name)
    resolved(path)
    if not path.exists() and str(path_or_name) in catalogue.names():
        given = {"units": units, "fps": fps, "format": format, "scale": scale, "individual": individual}
        given["plane"] = None if plane == FLAT else plane
        if surplus := [f"--{option}" for option, value in given.items() if value is not None]:
            raise InputError(f"{path_or_name} has known units and times: leave {', '.join(surplus)} out")
        recording = catalogue.load_named(str(path_or_name))
    else:
        catalogue.check_exists(path)
        recording = read_file(path, units, fps, keypoints, joints, format, base, scale, individual, plane, shifting)
    with about(path_or_name):
        recording = repaired(recording, shifting)
        recording = _keep(recording, keypoints, joints, base)
        for p, name in enumerate(recording.keypoint_names):
            if not np.isfinite(recording.keypoints[:, p]).all(axis=-1).any():
                raise InputError(f"keypoint {name!r} is missing in every frame")
        return recording


def read_file(
    path: Path,
    units: str | None = None,
    fps: float | None = None,
    keypoints: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    format: str | None = None,
    base: str | None = None,
    scale: float | None = None,
    individual: str | None = None,
    plane: str | None = None,
    shifting: Collection[str] = (),
) -> Recording:
    """A file with all that is in it; arguments and errors as those of `load`, which then keeps what is wanted."""
    form, declared = stated_format(path, units, fps, format, individual)
    with about(path):
        if form.read is None:
            recording = read_keypoint_csv(path, joints=joints, fps=fps)
        else:
            recording = form.read(path, fps, individual)
        recording = without_zeros(recording, pixels=declared.length == "px")
        if plane is not None:
            recording = planar(recording, plane, form.axes)
        elif rotated := read_as(form.axes):
            warnings.warn(f"{path}: y is up in this file, z is up here: {rotated}", stacklevel=2)
        angle = declared.angle or form.angle_unit(path)
        recording = to_si(recording, replace(declared, angle=angle), scale, fps, shifting)
        recording = replace(recording, units=declared)
        try:
            check_magnitudes(recording)
        except InputError:
            if scale is None or recording.angles is not None:
                raise
            raise InputError(
                f"--scale {scale:g} makes these keypoints larger than any body: expected metres a pixel, such as 0.002"
            ) from None
        if base is not None and base not in recording.keypoint_names:
            _check_base(recording, base, keypoints or (), own_frame=form.read is None)
        return recording


def stated_format(
    path: Path, units: str | None, fps: float | None, format: str | None, individual: str | None
) -> tuple[Format, Units]:
    """The format of a file, and its units, before its rows are read.

    Raises InputError for an unknown format, and for units, a rate or an animal that the file lacks or already says.
    """
    check_readable(path)
    kind = recognise(path, format)
    form = FORMATS[kind]
    with about(path):
        declared = parse_units(units)
        if form.read is None and numbers_frames(path):
            form = replace(form, title=f"frame-numbered {form.title}", own_times=False)
            declared = replace(declared, time=None if declared.time == FRAMES else declared.time)
        if form.own_times and fps is not None and declared.time != FRAMES:
            raise InputError(
                f"{form.title} files carry their own times: leave --fps out, or add --units frames if they are "
                "numbers of frames"
            )
        if not form.own_units and declared.length is None:
            raise InputError(f"{form.title} files do not say their units: pass --units px (or mm, cm, m)")
        if not form.own_times and fps is None:
            raise InputError(f"{form.title} files do not say their frame rate: pass --fps, frames a second")
        if fps is not None and not MIN_RATE <= fps <= MAX_RATE:
            raise InputError(f"--fps must be positive, from {MIN_RATE:g} to {MAX_RATE:g} frames a second, got {fps:g}")
        if kind in ("nexus", "c3d", "trc", "mot") and (declared.length or (declared.angle and kind != "mot")):
            raise InputError(f"{form.title} files carry their own units: leave --units out")
        if not form.animals and individual is not None:
            raise InputError(f"{form.title} files hold one body: leave individual out")
        _check_time_unit(form, declared, fps)
    return form, declared


def _check_time_unit(form: Format, declared: Units, fps: float | None) -> None:
    if declared.time is None:
        return
    if declared.time == FRAMES and form.own_times and fps is None:
        raise InputError("--units frames needs the frame rate: pass --fps, frames a second")
    if not form.own_times and declared.time != "s":
        raise InputError(f"{form.title} files number their frames, --fps says the rest: leave {declared.time!r} out")


def _check_base(recording: Recording, base: str, keypoints: Sequence[str], own_frame: bool) -> None:
    """Refuse a base that differs in case or space from a keypoint; say that it is not tracked, where that is odd.

    In the body's own frame, where a file of ours with its keypoints alone is by contract, a base need not be tracked.
    """
    known = recording.keypoint_names
    if near := same_letters(base, [name for name in known if name not in keypoints]):
        raise InputError(
            f"keypoint {near!r} differs from the first joint's name, {base!r}, in case or spaces alone: rename one of "
            f"them, or pass --set base={near}"
        )
    if known and not (own_frame and not {*known} > {*keypoints} > set()):
        warnings.warn(
            f"{recording.name}: the base {base!r} is not tracked (the file has {some(known)}), so it is taken to "
            "rest where the body's is, in the file's own frame; pass --set base=NAME, a keypoint, if it is one",
            stacklevel=2,
        )


def _keep(
    recording: Recording, keypoints: Sequence[str] | None, joints: Sequence[str] | None, base: str | None
) -> Recording:
    """The recording about its base, with the named keypoints and joints in their order."""
    if base is not None and base in recording.keypoint_names and np.isfinite(recording.keypoint(base)).any():
        recording = recording.about(base)
    if keypoints is not None and recording.keypoint_names:
        if base is not None and base in recording.keypoint_names:
            recording = _with_names_of(recording, keypoints, base)
        _check_names("keypoint", keypoints, recording.keypoint_names)
        if base is not None and base in recording.keypoint_names and base not in keypoints:
            keypoints = (base, *keypoints)
        recording = recording.with_keypoints(keypoints)
    if joints is not None and recording.joint_names:
        _check_names("joint", joints, recording.joint_names)
        recording = recording.with_joints(joints)
    return recording


def _with_names_of(recording: Recording, keypoints: Sequence[str], base: str) -> Recording:
    """The recording whose keypoints that are of the base's side have the body's names; a warning says which."""
    known = recording.keypoint_names
    called = of_one_side([name for name in keypoints if name not in known], known, base)
    if not called:
        return recording
    words = ", ".join(f"{name} is {other!r}" for other, name in called.items())
    warnings.warn(f"{recording.name}: {words}, as the base is {base!r}", stacklevel=3)
    return replace(recording, keypoint_names=tuple(called.get(name, name) for name in known))


def _check_names(kind: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            hint = closest(name, [other for other in known if other not in names])
            sided = kind == "keypoint" and hint and name.casefold() in hint.casefold()
            more = ", of a person by --set keypoints=NAME,…" if kind == "keypoint" else ""
            more = ", or pass --set base=NAME, the first joint's keypoint of that side" if sided else more
            raise InputError(f"{kind} {name!r} is missing: the file has {some(known)}{hint}; rename one of them{more}")
