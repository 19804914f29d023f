"""Several recordings of one body as one table, end to end."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from .errors import InputError
from .recording import Recording


def joined(recordings: Sequence[Recording]) -> tuple[Recording, tuple[int, ...]]:
    """One recording after the other, each a frame interval behind the one before, and the rows at which one starts.

    Times start at the first recording's own. The first row of all is not among the rows (R − 1,).

    Raises InputError for none, and where they are not of the same keypoints, coordinates, joints and unit, or not all
    have angles, torques or confidences.
    """
    if not recordings:
        raise InputError("expected one recording or more, got none")
    first = recordings[0]
    if len(recordings) == 1:
        return first, ()
    for other in recordings[1:]:
        for field in ("keypoint_names", "joint_names", "length_unit"):
            mine, yours = getattr(first, field), getattr(other, field)
            if mine != yours:
                raise InputError(
                    f"recordings to be diagnosed together must agree: {first.name} has {field} {mine}, "
                    f"{other.name} has {yours}"
                )
        axes = [each.keypoints.shape[-1] for each in (first, other)]
        if axes[0] != axes[1]:
            raise InputError(
                f"recordings to be diagnosed together must agree: keypoints of {first.name} have {axes[0]} "
                f"coordinates, those of {other.name} {axes[1]}"
            )
        for field in ("confidence", "angles", "torques"):
            if (getattr(first, field) is None) != (getattr(other, field) is None):
                raise InputError(
                    f"recordings to be diagnosed together must agree: of {first.name} and {other.name}, "
                    f"only one has {field}"
                )
    times, end = [], first.time[0] - first.frame_interval
    for each in recordings:
        times.append(each.time - each.time[0] + end + each.frame_interval)
        end = times[-1][-1]
    starts = np.cumsum([each.num_frames for each in recordings])[:-1]
    columns: dict[str, Any] = {
        field: None if getattr(first, field) is None else np.concatenate([getattr(r, field) for r in recordings])
        for field in ("keypoints", "confidence", "angles", "torques")
    }
    name = " + ".join(each.name for each in recordings)
    return replace(first, time=np.concatenate(times), name=name, **columns), tuple(int(s) for s in starts)
