"""From three coordinates to the two of the plane in which a body moves.

Planar trackers write files that have room for three coordinates with a constant in the third: it is left out, and
said. Otherwise the plane is chosen by two of the file's own axes, the one that points right and the one that points up.
"""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from itertools import permutations

import numpy as np

from .errors import InputError
from .recording import Recording

FLAT = "flat"
"""The plane of the two axes that are left when a constant one is taken out."""
CONSTANT_RANGE = 1e-6
"""Of the largest range, what a constant coordinate may vary by: the digits of a file, no camera's noise."""
PLANES = tuple("".join(axes) for axes in permutations("xyz", 2))
Axes = Mapping[str, tuple[int, float]]
"""Of each axis of a file: which of a Recording's axes it is, and its sign there."""
OURS: Axes = {"x": (0, 1.0), "y": (1, 1.0), "z": (2, 1.0)}


def read_as(axes: Axes) -> str:
    """Where a file's axes come to lie, "(x, y, z) is read as (x, −z, y)"; "" where they stay."""
    if axes == OURS:
        return ""
    found = {place: ("−" if sign < 0 else "") + axis for axis, (place, sign) in axes.items()}
    return f"({', '.join(axes)}) is read as ({', '.join(found[place] for place in sorted(found))})"


def planar(recording: Recording, plane: str, axes: Axes = OURS) -> Recording:
    """Keypoints (T, P, 3) → (T, P, 2).

    Args:
        recording: two coordinates are left as they are by `FLAT`.
        plane: two of the file's axes, such as "xz", or `FLAT`.
        axes: where the file's axes lie in the recording.

    Raises InputError for another plane, for one where there are two coordinates already, and where `FLAT` does not
    find exactly one coordinate to be constant.
    """
    if plane not in (FLAT, *PLANES):
        raise InputError(f"plane is two of the file's axes, one of {', '.join(PLANES)}, got {plane!r}")
    if recording.keypoints.shape[-1] == 2 or not recording.keypoint_names:
        if plane == FLAT:
            return recording
        raise InputError(f"plane {plane} chooses two of three coordinates, this file has two: leave it out")
    points = np.stack([sign * recording.keypoints[..., place] for place, sign in axes.values()], axis=-1)
    columns = dict(zip(axes, np.moveaxis(points, -1, 0), strict=True))
    if plane == FLAT:
        plane = _moving(columns)
    return replace(recording, keypoints=np.stack([columns[axis] for axis in plane], axis=-1))


def in_space(recording: Recording) -> bool:
    """Whether keypoints have three coordinates of which none is constant."""
    points = recording.keypoints
    if points.shape[-1] != 3 or not points.size:
        return False
    return not _constant(dict(zip(OURS, np.moveaxis(points, -1, 0), strict=True)))[1]


def _constant(columns: Mapping[str, np.ndarray]) -> tuple[dict[str, float], list[str]]:
    """Each axis's range, and the axes that are constant."""
    ranges = {axis: float(np.nanmax(values) - np.nanmin(values)) for axis, values in columns.items()}
    return ranges, [axis for axis, size in ranges.items() if size <= CONSTANT_RANGE * max(ranges.values())]


def _moving(columns: Mapping[str, np.ndarray]) -> str:
    ranges, constant = _constant(columns)
    if len(constant) != 1:
        widest = "".join(sorted(sorted(ranges, key=ranges.__getitem__)[1:]))
        sizes = ", ".join(f"{axis} by {size:.3g}" for axis, size in ranges.items())
        raise InputError(
            f"keypoints have three coordinates ({sizes} from least to most), but the body moves in a plane: name the "
            f"file's axes that point right and up, such as --set plane={widest}"
        )
    (out,) = constant
    warnings.warn(f"coordinate {out} is {np.nanmedian(columns[out]):g} throughout: left out", stacklevel=2)
    return "".join(axis for axis in columns if axis != out)
