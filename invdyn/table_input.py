"""A table of keypoints, angles and commands as a recording of a body, in the plane or in space."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from invdyn.inference.plausible_for_body import at_rest, check_fits, rooted, site_at_base, slides
from invdyn.inference.posterior.base_motion import base_motion
from invdyn.models import Body, dynamics_for
from invdyn.recordings import FORMATS, InputError, Recording, bridged, in_body_lengths, load, parse_units
from invdyn.recordings.errors import about
from invdyn.recordings.formats.registry import recognise
from invdyn.recordings.naming import closest
from invdyn.recordings.plane import FLAT
from invdyn.recordings.reading import Reading

from .input_names import frame_range

BODY = "body"
"""A scale that is not known: tracks are scaled to the length of the body."""


def read_table(
    files: Sequence[str],
    body: Body,
    *,
    frames: str = ":",
    as_filmed: bool = False,
    as_it_stands: bool = False,
    guessed: bool = False,
    units: str | None = None,
    fps: float | None = None,
    format: str | None = None,
    scale: float | str | None = None,
    base: str | None = None,
    individual: str | None = None,
    plane: str | None = None,
) -> list[Reading]:
    """The one recording of a file: keypoints and joints of the body, checked against its lengths.

    Args:
        files: one file, or the name of a known recording.
        body: says which keypoints and joints, and their order.
        frames: which rows, such as "50:250"; long gaps in them are bridged (:mod:`invdyn.recordings.pace`).
        as_filmed: for a diagnosis, which takes the base to be at rest. Keypoints are left as they are, if the file is
            in metres and ``base`` is not given; a base that moves is else taken away, row by row. A warning says so.
        as_it_stands: check nothing, leave nothing out, and take numbers without ``units`` to be SI.
        guessed: the body's lengths are, and will be learned.
        units, fps, format, individual: as of :func:`invdyn.recordings.load`.
        scale: metres a pixel; "body", in the plane alone, for that of the body's own length. The base must then be
            tracked. A warning says so unless the body is in body lengths itself.
        base: the keypoint at the first joint; in the plane by default the one with the joint's name. Where the file
            has it, all are moved by one constant, to the body's own base, and it is kept under the joint's name.
        plane: two of the file's axes; by default a constant third coordinate is left out for a body in the plane.

    Raises:
        InputError: the file, or the file together with the body, makes no sense.
        OSError: the file cannot be opened.
    """
    (name,) = files
    options: dict[str, Any] = {"units": units, "fps": fps, "format": format, "individual": individual, "plane": plane}
    stated, rows = parse_units(units), frame_range(frames)
    if as_it_stands:
        if _is_own(name, format):
            usual = {"s": stated.time, "rad": stated.angle, "m": stated.length}
            missing = [unit for unit, given in usual.items() if given is None]
            options["units"] = ",".join([units, *missing] if units else missing)
        options["plane"] = plane or (FLAT if body.dimensions == 2 else None)
        recording = load(name, joints=body.joint_names, shifting=slides(body), **options)
        return [Reading(recording.at(rows))]
    if isinstance(scale, str) and scale != BODY:
        raise InputError(f"scale: expected metres a pixel, or {BODY!r}, got {scale!r}")
    unscaled = scale == BODY
    options["scale"] = None if unscaled else scale
    read = _in_plane if body.dimensions == 2 else _in_space
    recording, length = read(name, body, base, unscaled, as_filmed, options)
    if base is not None and not {base, body.base_keypoint} & {*recording.keypoint_names}:
        got = ", ".join(recording.keypoint_names) or "none"
        raise InputError(f"{name}: expected a keypoint {base!r}, for --set base, got {got}: name the first joint's")
    with about(name):
        steady, own = at_rest(recording, body, base)
        check_fits(steady, body, guessed or unscaled)
        if as_filmed and own is not None:
            recording = _for_diagnosis(name, recording, steady, own)
        first = rows.indices(recording.num_frames)[0]
        return [Reading(bridged(recording.at(rows), length, first))]


def load_recording(name: str, body: Body, **options: Any) -> Recording:
    """The recording in one file; see :func:`read_table`."""
    return read_table([name], body, **options)[0].recording


def _in_plane(
    name: str, body: Any, base: str | None, unscaled: bool, as_filmed: bool, options: dict[str, Any]
) -> tuple[Recording, float]:
    """The recording of a chain in the plane, and the chain's length."""
    options = options | {"plane": options.get("plane") or FLAT, "joints": body.joint_names}
    total = sum(link.nominal("length") for link in body.links)
    units = parse_units(options.get("units"))
    stated = any((base, unscaled, options["scale"], units.length, units.angle))
    in_frame = as_filmed and not stated and _is_own(name, options.get("format"))
    base, tips = base or body.joint_names[0], body.keypoint_names
    if in_frame:
        whole = recording = load(name, **options)
        known = (base, *tips)
        if strange := [point for point in recording.keypoint_names if point not in known]:
            raise _not_of_the_body(
                name, strange[0], known, [tip for tip in known if tip not in recording.keypoint_names]
            )
        recording = recording.with_keypoints([tip for tip in tips if tip in recording.keypoint_names])
        if base in whole.keypoint_names:
            _said_to_move(name, whole, base)
    elif unscaled:
        recording = load(name, keypoints=(base, *tips), base=base, **options)
        recording = in_body_lengths(recording, length=total)
        if recording.length_unit == "m":
            warnings.warn(
                f"{name}: no scale is known: keypoints are scaled so that the tracked arm is as long as the "
                f"body's links together, {total:.3g} m",
                stacklevel=2,
            )
    else:
        recording = load(name, keypoints=tips, base=base, **options)
    if not in_frame:
        recording = _on_body(recording, body, base)
    if recording.length_unit == "px":
        raise InputError(
            f"{name}: keypoints are in px, the body is not: pass --scale with metres a pixel, or --scale body"
        )
    return recording, total


def _in_space(
    name: str, body: Any, base: str | None, unscaled: bool, as_filmed: bool, options: dict[str, Any]
) -> tuple[Recording, float]:
    """The recording of some sites of a body in space, of its joints, or both, and the body's reach.

    Keypoints that are not of the body are refused in our own file, and left out of a tracker's.
    """
    if options.get("plane"):
        raise InputError(f"body '{body.name}' moves in space: leave plane out, which is for one that moves in a plane")
    if unscaled:
        raise InputError("--scale body is for a chain in the plane: give a recording in space its --units")
    if not body.keypoint_names:
        raise InputError(f"body '{body.name}' names no point: give its last link a tip, or a site, for what is drawn")
    own_file = _is_own(name, options.get("format"))
    recording = load(name, joints=body.joint_names, base=base, shifting=slides(body), **options)
    points, sites = recording.keypoint_names, body.keypoint_names
    if points and recording.keypoints.shape[-1] != 3:
        raise InputError(
            f"{name}: keypoints have two coordinates, but body '{body.name}' moves in space: give {points[0]}_z and "
            "the like too, or a planar body"
        )
    strange = [point for point in points if point not in sites and point != base]
    if strange and (own_file or len(strange) == len(points)):
        hint = "" if base else f", or pass --set base={strange[0]} if it is the first joint's own track"
        raise _not_of_the_body(name, strange[0], sites, [site for site in sites if site not in points], hint)
    tracked = {base, site_at_base(body)} & {*points}
    if not tracked and points and not own_file and rooted(body):
        warnings.warn(
            f"{name}: no base is tracked (the file has {', '.join(points)}), so it is taken to rest where the body's "
            "is, in the file's own frame; pass --set base=NAME, the first joint's keypoint if there is one",
            stacklevel=2,
        )
    numbers = body.parameters()
    recording = recording.with_keypoints([point for point in points if point in sites or point == base])
    recording = _on_body(recording, body, base)
    return recording, dynamics_for(body).reach(numbers).item()


def _on_body(recording: Recording, body: Any, base: str | None) -> Recording:
    """The recording moved to the body's own base, whose keypoint then has the body's name for it."""
    if base not in recording.keypoint_names:
        return recording
    own = base if base in body.keypoint_names or body.base_keypoint is None else body.base_keypoint
    names = tuple(own if point == base else point for point in recording.keypoint_names)
    return replace(recording, keypoint_names=names).moved(body.base)


def _for_diagnosis(name: str, recording: Recording, steady: Recording, base: str) -> Recording:
    """The recording without its base's keypoint; less its track, row by row, where that moves."""
    return steady if _said_to_move(name, recording, base) else recording.with_keypoints(steady.keypoint_names)


def _said_to_move(name: str, recording: Recording, base: str) -> bool:
    """Whether the base moves, which a warning then says."""
    found = base_motion(recording.time, recording.keypoint(base))
    if found.moves:
        warnings.warn(
            f"{name}: the base {base!r} moves, by {found.displacement:.2g} {recording.length_unit} and with "
            f"{found.acceleration:.2g} {recording.length_unit}/s² (rms), and a diagnosis takes it to be at rest: what "
            "it finds may be that motion. `invdyn infer` has a base that moves in its model",
            stacklevel=5,
        )
    return found.moves


def _is_own(name: str, format: str | None) -> bool:
    """Whether a file is in the project's own format, which is in the body's frame by contract."""
    return Path(name).exists() and FORMATS[recognise(Path(name), format)].read is None


def _not_of_the_body(name: str, point: str, known: Sequence[str], free: Sequence[str], hint: str = "") -> InputError:
    return InputError(
        f"{name}: keypoint {point!r} is not of the body, which has {', '.join(known)}{closest(point, free)}: "
        f"rename one of them{hint}"
    )
