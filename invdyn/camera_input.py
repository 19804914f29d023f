"""Tracks of several cameras, in pixels, as a recording of a body in space."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from invdyn.inference.plausible_for_body import check_fits
from invdyn.models import Body, dynamics_for
from invdyn.recordings import InputError
from invdyn.recordings.cameras import Filmed, load_filmed
from invdyn.recordings.reading import Reading

from .input_names import camera_offset, frame_range

MAX_SIZE_RATIO = 5.0
"""How many times larger, or smaller, than the body the cameras' points may be."""


def read_cameras(
    files: Sequence[str],
    body: Body,
    *,
    calibration: Sequence[Path],
    frames: str = ":",
    guessed: bool = False,
    offset: Sequence[str] | None = None,
    fps: float | None = None,
    format: str | None = None,
    individual: str | None = None,
) -> list[Reading]:
    """One recording, of the pixels and of the points triangulated from them.

    Args:
        files, calibration, fps, format, individual: as of :func:`.cameras.filmed.load_filmed`.
        body: in space.
        frames: which rows, such as "50:250".
        guessed: refused, as lengths are in the calibration's unit.
        offset: of cameras' clocks, such as "cam2=0.02".

    Raises:
        InputError: a body in the plane, points that are not this body's, or as `load_filmed`.
        OSError: a file that cannot be opened.
    """
    if body.is_chain:
        raise InputError(f"{body.name}: cameras see a body in space, this one is in the plane: give it dimensions = 3")
    if guessed:
        raise InputError(
            "the lengths of a calibration are in metres: leave --learn lengths out; a length to learn is "
            "{start = 0.3} in the body's file"
        )
    options: dict[str, Any] = {"fps": fps, "format": format, "individual": individual}
    clocks = dict(map(camera_offset, offset or ()))
    found = load_filmed(files, calibration, body.keypoint_names, offsets=clocks, **options)
    _check_size(found, body)
    _check_points(found, body)
    return [Reading(found.at(frame_range(frames)))]


def _check_size(recording: Filmed, body: Body) -> None:
    """Refuse points that are much farther from each other, or nearer, than those of the body can be."""
    if len(recording.keypoint_names) < 2:
        return
    numbers = body.parameters()
    sites = [body.keypoint_names.index(name) for name in recording.keypoint_names]
    still = dynamics_for(body).keypoints(numbers.gravity.new_zeros(body.num_joints), numbers)[sites].numpy()
    own, seen = _extent(still[None]), _extent(recording.keypoints)
    if own > 0 and np.isfinite(seen) and not 1 / MAX_SIZE_RATIO < seen / own < MAX_SIZE_RATIO:
        raise InputError(
            f"{recording.name}: the cameras see keypoints {seen:.3g} m apart, those of body '{body.name}' are "
            f"{own:.3g} m: is the calibration in metres, and are they of the same film?"
        )


def _check_points(recording: Filmed, body: Body) -> None:
    """Refuse lengths, names, times and speeds that are not the body's, by the triangulated points."""
    try:
        check_fits(recording.points, body)
    except InputError as error:
        raise InputError(
            f"{recording.name}: {error} (of points triangulated from the cameras, in the calibration's frame and "
            "unit: --units, --scale and --set base are not of these)"
        ) from None


def _extent(points: np.ndarray) -> float:
    """Median over rows (T, P, 3) of the largest distance of two points, m; NaN where never two are known."""
    apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1)
    known = np.where(np.isfinite(apart), apart, 0.0).max((1, 2))
    return float(np.median(known[known > 0])) if (known > 0).any() else math.nan
