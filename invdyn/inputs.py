"""What a command is given: a body, a recording that fits it, a range of frames."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.models import Body
from invdyn.recordings import (
    FORMATS,
    InputError,
    Recording,
    Truth,
    bridged,
    check_plausible,
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
from invdyn.recordings.naming import nearest
from invdyn.recordings.plane import FLAT


def load_body(name: str) -> Body:
    """A body file, or a body that comes with the package by its name. Raises BodyError or OSError."""
    if resolved(name).exists():
        return Body.load(check_readable(name))
    ours = {
        Path(file.name).stem: file for file in files("invdyn.models.bodies").iterdir() if file.name.endswith(".toml")
    }
    if name not in ours:
        raise FileNotFoundError(2, f"no such body file, nor one of ours ({', '.join(sorted(ours))})", name)
    with as_file(ours[name]) as path:
        return Body.from_toml(path)


def load_recording(
    name: str,
    body: Body,
    base: str | None,
    body_lengths: bool,
    as_filmed: bool = False,
    frames: str = ":",
    **options: Any,
) -> Recording:
    """Recording of `body`'s tips and joints, checked against its lengths; `options` as `recordings.load`'s.

    Args:
        name: a file, or the name of a known recording.
        body: says which keypoints and joints, and their order.
        base: the keypoint at the first joint; by default the one with the joint's name. Where the file has it, all
            others are taken relative to it, and moved to the body's own base.
        body_lengths: take the scale from the body's own length, and warn. The base must be tracked.
        as_filmed: leave keypoints as they are, if the file is in metres and `base` is not given. Subtracting the base
            would hide a tilted camera, and add the base's noise to all keypoints.
        frames: which rows, such as "50:250"; long gaps in them are bridged (:mod:`invdyn.recordings.pace`).
        options: units, fps, format, scale … A body moves in a plane: without `plane` a constant third coordinate is
            left out.

    Raises:
        InputError: the file, or the file beside the body, makes no sense.
        OSError: the file cannot be opened.
    """
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
                f"{name}: keypoint {strange[0]!r} is not of the body, which has {', '.join((base, *tips))} "
                f"(closest: {nearest(strange[0], (base, *tips))!r}): rename one of them"
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
        check_plausible(recording, lengths, body.base, units)
        start, stop = frame_range(frames)
        first = slice(start, stop).indices(recording.num_frames)[0]
        return bridged(recording.select(start, stop), sum(lengths), first)


def _with_keypoints(recording: Recording, order: Sequence[int]) -> Recording:
    """Only the keypoints of those numbers."""
    places, confidence = list(order), recording.confidence
    return replace(
        recording,
        keypoints=recording.keypoints[:, places],
        keypoint_names=tuple(recording.keypoint_names[place] for place in places),
        confidence=None if confidence is None else confidence[:, places],
    )


def load_known(name: str, body: Body) -> Truth:
    """A truth file, or what a known recording's own sensors measured. Raises InputError or OSError."""
    known = load_truth(name) if not resolved(name).exists() and name in names() else read_truth(name)
    if missing := [joint for joint in body.joint_names if joint not in known.joint_names]:
        raise InputError(f"{name}: joint '{missing[0]}' is missing; it has {', '.join(known.joint_names)}")
    return known


def frame_range(text: str) -> tuple[int | None, int | None]:
    """Start and stop of "50:250", "50:" or ":250". Raises InputError for anything else."""
    try:
        start, stop = (int(part) if part.strip() else None for part in text.split(":"))
    except ValueError:
        raise InputError(f"--frames is START:STOP, such as 50:250, got {text!r}") from None
    return start, stop
