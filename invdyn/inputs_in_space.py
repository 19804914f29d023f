"""A recording of a body in space: which of its sites and joints it shows, and whether it can be this body's."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from invdyn.inference.plausible_for_body import check_fits, rooted
from invdyn.models import Tree, dynamics_for
from invdyn.recordings import (
    FORMATS,
    InputError,
    Recording,
    bridged,
    load,
    parse_units,
)
from invdyn.recordings.errors import about
from invdyn.recordings.formats import recognise
from invdyn.recordings.naming import closest


def load_in_space(
    name: str, body: Tree, base: str | None, body_lengths: bool, frames: slice, guessed: bool, **options: Any
) -> Recording:
    """Recording of some of `body`'s sites, of its joints, or both; see `inputs.load_recording`.

    Keypoints that are not of the body are refused in our own file, and left out of a tracker's. Where `base` is
    tracked the others are taken relative to it, and lie about the place of the body's first joint.

    Raises:
        InputError: the file, or the file beside the body, makes no sense.
        OSError: the file cannot be opened.
    """
    if options.get("plane"):
        raise InputError(
            f"body '{body.name}' moves in space: leave --plane out, which is for one that moves in a plane"
        )
    if body_lengths:
        raise InputError("--body-lengths is for a chain in the plane: give a recording in space its --units")
    if not body.keypoint_names:
        raise InputError(f"body '{body.name}' names no point: give its last link a tip, or a site, for what is drawn")
    recording = load(name, joints=body.joint_names, base=base, **options)
    names, sites = recording.keypoint_names, body.keypoint_names
    if names and recording.keypoints.shape[-1] != 3:
        raise InputError(
            f"{name}: keypoints have two coordinates, but body '{body.name}' moves in space: give {names[0]}_z and the "
            "like too, or a planar body"
        )
    strange = [point for point in names if point not in sites and point != base]
    own_file = Path(name).exists() and FORMATS[recognise(Path(name), options.get("format"))].read is None
    if strange and (own_file or len(strange) == len(names)):
        raise InputError(
            f"{name}: keypoint {strange[0]!r} is not of the body, which has {', '.join(sites)}"
            f"{closest(strange[0], [site for site in sites if site not in names])}: rename one of them"
            + ("" if base else f", or pass --base {strange[0]} if it is the first joint's own track")
        )
    if base not in names and names and not own_file and rooted(body):
        warnings.warn(
            f"{name}: no base is tracked (the file has {', '.join(names)}), so it is taken to rest where the body's "
            "is, in the file's own frame; pass --base with the keypoint at the first joint if there is one",
            stacklevel=2,
        )
    order = [place for place, point in enumerate(names) if point in sites]
    confidence = recording.confidence
    recording = replace(
        recording,
        keypoints=recording.keypoints[:, order],
        keypoint_names=tuple(names[place] for place in order),
        confidence=None if confidence is None else confidence[:, order],
    )
    numbers = body.parameters()
    if base in names:
        recording = replace(recording, keypoints=recording.keypoints + numbers.position[0].numpy())
    with about(name):
        check_fits(recording, body, parse_units(options.get("units")), guessed)
        first = frames.indices(recording.num_frames)[0]
        return bridged(recording.at(frames), dynamics_for(body).reach(numbers).item(), first)
