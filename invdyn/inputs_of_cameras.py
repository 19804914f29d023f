"""What a command is given of several cameras: tracks in pixels, their calibration, and a body in space."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.inference.plausible_for_body import check_fits
from invdyn.models import Tree, dynamics_for
from invdyn.recordings import InputError
from invdyn.recordings.cameras import Filmed, load_filmed
from invdyn.recordings.units import Units

from .inputs import frame_range, load_body

TOO_FAR = 5.0
"""Times larger, or smaller, than the body that what the cameras saw cannot be."""


def load_from_cameras(
    files: Sequence[str],
    calibration: Sequence[Path],
    body: str,
    frames: str,
    offsets: Sequence[str],
    in_metres: Mapping[str, object],
    **options: Any,
) -> tuple[Filmed, Tree]:
    """The recording and its body.

    Args:
        files, calibration, options: as `load_filmed`'s.
        body: a file, or the name of one of ours.
        frames: which rows, such as "50:250".
        offsets: of cameras' clocks, such as "cam2=0.02".
        in_metres: option -> value, None or False where it is not given, of what only other recordings have.

    Raises:
        InputError: a body in the plane, such an option, points that are not this body's, or as `load_filmed`.
        BodyError: as `load_body`.
        OSError: a file that cannot be opened.
    """
    tree = load_body(body)
    if not isinstance(tree, Tree):
        raise InputError(f"{body}: cameras see a body in space, this one is in the plane: give it dimensions = 3")
    if surplus := [name for name, value in in_metres.items() if value not in (None, False)]:
        hint = "; a length to learn is {start = 0.3} in the body's file" if surplus[0] == "--learn-lengths" else ""
        raise InputError(
            f"tracks of several cameras are in pixels, and their calibration in metres: leave {surplus[0]} out{hint}"
        )
    clocks = dict(map(camera_offset, offsets))
    found = load_filmed(files, calibration, tree.keypoint_names, offsets=clocks, **options)
    _check_size(found, tree)
    _check_points(found, tree)
    return found.at(slice(*frame_range(frames))), tree


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


def _check_size(recording: Filmed, body: Tree) -> None:
    """Refuse points that are much farther from each other, or nearer, than those of the body can be."""
    if len(recording.keypoint_names) < 2:
        return
    numbers = body.parameters()
    sites = [body.keypoint_names.index(name) for name in recording.keypoint_names]
    still = dynamics_for(body).keypoints(numbers.gravity.new_zeros(body.num_joints), numbers)[sites].numpy()
    own, seen = _extent(still[None]), _extent(recording.keypoints)
    if own > 0 and np.isfinite(seen) and not 1 / TOO_FAR < seen / own < TOO_FAR:
        raise InputError(
            f"{recording.name}: the cameras see keypoints {seen:.3g} m apart, those of body '{body.name}' are "
            f"{own:.3g} m: is the calibration in metres, and are they of the same film?"
        )


def _check_points(recording: Filmed, body: Tree) -> None:
    """Refuse lengths, names, times and speeds that are not the body's, by the points triangulated of the pixels."""
    try:
        check_fits(recording.points, body, Units())
    except InputError as error:
        raise InputError(
            f"{recording.name}: {error} (of points triangulated of the cameras, in the calibration's frame and unit: "
            "--units, --scale and --base are not of these)"
        ) from None


def _extent(points: np.ndarray) -> float:
    """Median over rows (T, P, 3) of the largest distance of two points, m; NaN where never two are known."""
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    known = np.where(np.isfinite(apart), apart, 0.0).max((1, 2))
    return float(np.median(known[known > 0])) if (known > 0).any() else math.nan
