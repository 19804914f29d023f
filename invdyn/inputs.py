"""What a command is given: a body, a recording that fits it, a range of frames."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.inference.plausible_for_body import check_fits, slides
from invdyn.models import Body, Tree
from invdyn.models import load_body as read_body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.bodies.body_xml import is_xml
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.recordings import (
    FORMATS,
    InputError,
    Recording,
    Truth,
    bridged,
    check_readable,
    in_body_lengths,
    load,
    load_truth,
    names,
    parse_units,
    read_truth,
    resolved,
)
from invdyn.recordings.errors import about
from invdyn.recordings.formats import recognise
from invdyn.recordings.logs import LogMap, recordings_of
from invdyn.recordings.logs.mapping import JointMap
from invdyn.recordings.logs.read import Logged, kind_of
from invdyn.recordings.naming import closest
from invdyn.recordings.plane import FLAT, in_space
from invdyn.recordings.reading import Reading

from .inputs_in_space import load_in_space
from .named_files import body_file


def load_body(name: str, *, filmed: bool = True, recording: str | None = None, **options: Any) -> Body | Tree:
    """A body file, or a body that comes with the package by its name. Raises BodyError or OSError.

    A robot of parallel hinges is a body in space if its ``recording``, read with ``options``, has three coordinates.
    ``filmed``: whether keypoints in a plane may show it; see :func:`invdyn.models.load_body`.
    """
    with body_file(name) as path:
        shown = recording is not None and is_xml(path.read_bytes()) and in_space(load(recording, **options))
        return read_body(path, filmed=filmed, dimensions=3 if shown else None)


def load_planar(name: str, what: str) -> Body:
    """As :func:`load_body`; raises InputError, which says ``what`` wants a planar chain, for a body in space."""
    body = load_body(name)
    if isinstance(body, Tree):
        raise InputError(
            f"{name}: {what} takes a chain of hinges in the plane so far, and this body moves in space; "
            "infer and compare take it"
        )
    return body


def load_recording(
    name: str,
    body: Body | Tree,
    base: str | None,
    body_lengths: bool,
    as_filmed: bool = False,
    frames: str = ":",
    guessed: bool = False,
    **options: Any,
) -> Recording:
    """Recording of `body`'s tips and joints, checked against its lengths; `options` as `recordings.load`'s.

    Args:
        name: a file, or the name of a known recording.
        body: says which keypoints and joints, and their order.
        base: the keypoint at the first joint; by default the one with the joint's name. Where the file has it, all
            others are taken relative to it, and moved to the body's own base.
        body_lengths: take the scale from the body's own length, and warn unless the body is in body lengths itself. The
            base must be tracked. Of planar bodies alone.
        as_filmed: leave keypoints as they are, if the file is in metres and `base` is not given. Subtracting the base
            would hide a tilted camera, and add the base's noise to all keypoints.
        guessed: the body's lengths are, and will be learned.
        frames: which rows, such as "50:250"; long gaps in them are bridged (:mod:`invdyn.recordings.pace`).
        options: units, fps, format, scale … A body moves in a plane: without `plane` a constant third coordinate is
            left out.

    Raises:
        InputError: the file, or the file beside the body, makes no sense.
        OSError: the file cannot be opened.
    """
    if isinstance(body, Tree):
        options["shifting"] = slides(body)
        return load_in_space(name, body, base, body_lengths, slice(*frame_range(frames)), guessed, **options)
    options["plane"] = options.get("plane") or FLAT
    lengths = [link.nominal("length") for link in body.links]
    units = parse_units(options.get("units"))
    told = body_lengths or any((base, units.length, units.angle, options.get("scale")))
    in_frame = as_filmed and not told and Path(name).exists()
    in_frame = in_frame and FORMATS[recognise(Path(name), options.get("format"))].read is None
    base = base or body.base_keypoint
    tips = body.keypoint_names
    if in_frame:
        recording = load(name, joints=body.joint_names, **options)
        strange = [point for point in recording.keypoint_names if point not in (base, *tips)]
        if strange:
            raise InputError(
                f"{name}: keypoint {strange[0]!r} is not of the body, which has {', '.join((base, *tips))}"
                f"{closest(strange[0], [tip for tip in (base, *tips) if tip not in recording.keypoint_names])}: "
                "rename one of them"
            )
        order = [recording.keypoint_names.index(tip) for tip in tips if tip in recording.keypoint_names]
        recording = _with_keypoints(recording, order)
    elif body_lengths:
        recording = load(name, keypoints=(base, *tips), joints=body.joint_names, base=base, **options)
        recording = in_body_lengths(recording, length=sum(lengths))
        recording = _with_keypoints(recording, range(1, len(tips) + 1))
        if recording.length_unit == "m":
            warnings.warn(
                f"{name}: no scale is known: keypoints are scaled so that the tracked arm is as long as the "
                f"body's links together, {sum(lengths):.3g} m",
                stacklevel=2,
            )
    else:
        recording = load(name, keypoints=tips, joints=body.joint_names, base=base, **options)
    if not in_frame and any(body.base) and base in load(name, joints=body.joint_names, **options).keypoint_names:
        # what was taken relative to the base's own track lies about the body's base
        recording = replace(recording, keypoints=recording.keypoints + np.asarray(body.base))
    if recording.length_unit == "px":
        raise InputError(
            f"{name}: keypoints are in px, the body is not: pass --scale (metres a pixel) or --body-lengths"
        )
    with about(name):
        check_fits(recording, body, units, guessed or body_lengths)
        start, stop = frame_range(frames)
        first = slice(start, stop).indices(recording.num_frames)[0]
        return bridged(recording.select(start, stop), sum(lengths), first)


def read_logs(
    name: str,
    body: Body | Tree,
    mapping: str | None = None,
    episodes: Sequence[int] | None = None,
    frames: str = ":",
    units: str | None = None,
) -> list[Reading]:
    """A robot's own log, an episode each, as recordings of ``body``: angles and commands as its file counts them.

    Joints' angles become the body's (θ = zero + sign · q), torques take the sign along, and a servo's targets become
    the torque that they ask for by themselves, which is what a model is told. Each says where its units stand, and how
    it reads in others.

    Raises InputError for a log, a mapping or episodes that make no sense, targets of a joint without a servo, and
    ``units`` that do not stand in the mapping.
    """
    if units is not None:
        place = mapping or "a mapping (--map)"
        raise InputError(f"--units {units}: a log's units stand in {place}, track by track: leave --units out")
    given = None if mapping is None else LogMap.load(check_readable(mapping))
    if given is not None:
        with about(str(mapping)):
            given.check_kinds(slides(body))
    start, stop = frame_range(frames)

    def read(**scales: float) -> list[Recording]:
        found = recordings_of(name, body.joint_names, given, episodes, **scales)
        return [_in_the_bodys_terms(logged, body).select(start, stop) for logged in found]

    declared = (given or LogMap()).units
    maps = tuple(given.joints.get(name, JointMap()) for name in body.joint_names) if given else ()
    targets = any((own or NOTHING).servo is not None for own in body.joint_parts)
    return [
        Reading(recording, declared, lambda n=n, **scales: read(**scales)[n], targets, maps)
        for n, recording in enumerate(read())
    ]


def _in_the_bodys_terms(logged: Logged, body: Body | Tree) -> Recording:
    recording, commands = logged.recording, np.full(logged.targets.shape, np.nan)
    parts = [own or NOTHING for own in body.joint_parts]
    sign, zero = np.array([own.sign for own in parts]), np.array([own.zero for own in parts])
    if recording.torques is not None:
        commands = sign * recording.torques
    for k, (joint, own) in enumerate(zip(body.joint_names, parts, strict=True)):
        target = logged.targets[:, k]
        if not np.isfinite(target).any():
            continue
        if own.servo is None:
            raise InputError(
                f"{recording.name}: targets of joint {joint!r}, which has no servo in the robot's file: give it one "
                '(<position> in MJCF, motor = {kind = "position", …} in TOML), or its torques'
            )
        commands[:, k] = servo_torque(own.servo, sign[k] * target + zero[k] * (own.servo.kind == "position"))
    angles = None if recording.angles is None else zero + sign * recording.angles
    told = commands if np.isfinite(commands).any() else None
    return replace(recording, angles=angles, torques=told)


def is_log(name: str, mapping: str | None = None) -> bool:
    """Whether a file is read as a robot's log: there is a mapping, or it is no table of keypoints by its kind."""
    return mapping is not None or kind_of(Path(name)) not in (None, "csv")


def read_as_it_stands(
    name: str,
    body: Body | Tree,
    units: str | None = None,
    frames: str = ":",
    mapping: str | None = None,
    episode: int | None = None,
    fps: float | None = None,
) -> Reading:
    """A robot's log as it stands, for a check: numbers are taken to be SI, whatever their size, unless ``units`` say.

    Raises as readers do, and InputError for ``units`` or ``fps`` beside a mapping, in which they stand.
    """
    if is_log(name, mapping):
        if fps is not None:
            raise InputError(f"--fps {fps:g}: a robot's log carries its own times: leave --fps out")
        return read_logs(name, body, mapping, [episode or 0], frames, units)[0]
    said = parse_units(units)
    own = [unit for unit, given in (("s", said.time), ("rad", said.angle), ("m", said.length)) if given is None]
    if Path(name).exists() and FORMATS[recognise(Path(name))].read is None:
        units = ",".join([units, *own] if units else own)
    plane = FLAT if body.space == 2 else None
    recording = load(name, joints=body.joint_names, units=units, fps=fps, plane=plane, shifting=slides(body))
    start, stop = frame_range(frames)
    return Reading(recording.select(start, stop), said)


def _with_keypoints(recording: Recording, order: Sequence[int]) -> Recording:
    """Only the keypoints of those numbers."""
    places, confidence = list(order), recording.confidence
    return replace(
        recording,
        keypoints=recording.keypoints[:, places],
        keypoint_names=tuple(recording.keypoint_names[place] for place in places),
        confidence=None if confidence is None else confidence[:, places],
    )


def load_known(name: str, body: Body | Tree) -> Truth:
    """A truth file, or what a known recording's own sensors measured. Raises InputError or OSError."""
    known = load_truth(name) if not resolved(name).exists() and name in names() else read_truth(name)
    if missing := [joint for joint in body.joint_names if joint not in known.joint_names]:
        raise InputError(f"{name}: joint '{missing[0]}' is missing; it has {', '.join(known.joint_names)}")
    return known


def frame_range(text: str) -> tuple[int | None, int | None]:
    """Start and stop of "50:250", "50:" or ":250". Raises InputError for anything else, and for no rows."""
    try:
        start, stop = (int(part) if part.strip() else None for part in text.split(":"))
    except ValueError:
        raise InputError(f"--frames is START:STOP, such as 50:250, got {text!r}") from None
    if start is not None and stop is not None and (start < 0) == (stop < 0) and start >= stop:
        raise InputError(f"--frames is START:STOP, the first row and the one after the last, got {text}: no rows")
    return start, stop
