"""By how much each camera's clock runs ahead of the first one's, from the tracks alone.

A camera whose stamps are off sees a limb where it is not yet, or no more: its rays miss those of the others, the faster
the limb the more. Cameras join one after the other; the offset of the one that joins makes σ, the scale of a pixel's
error that `triangulate` finds, least: first over a grid of two frame intervals, then by Brent's method between the best
point's neighbours. For fractions of a frame all tracks pass one Gaussian window of one frame interval: interpolation
alone would average noise away halfway between frames, and draw the offset there. Without motion σ hardly depends on
the offset, and nothing is found.
"""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import minimize_scalar

from ..errors import InputError
from ..recording import Recording
from .camera import Calibration
from .triangulate import triangulate

MOST_FRAMES = 150
"""Frames that are looked at, spread over the film."""
CORRELATED = 4
"""Neighbouring frames under a window that count as one."""
LEAST = 5.0
"""By how many of its standard deviations log σ must dip."""


def find_offsets(
    tracks: Mapping[str, Recording],
    calibration: Calibration,
    reach: float = 0.25,
    progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, float]:
    """Offsets of all cameras but the first, s, for `at_one_time`.

    Args:
        tracks: camera → its tracks, pixels.
        calibration: the cameras.
        reach: s, how far off a clock may be; at most as long as the first film.
        progress: called as (done, total, what).

    Raises:
        InputError: a reach that is not positive or longer than the film, nothing moves enough to tell, or the best
            offset is farther than `reach`; as `triangulate`.
    """
    first, *others = tracks
    window = tracks[first].frame_interval
    at = tracks[first].time
    if not 0 < reach <= at[-1] - at[0]:
        raise InputError(f"a clock may be off by up to the film's length, {at[-1] - at[0]:.3g} s, got {reach:g} s")
    at = at[:: -(-len(at) // MOST_FRAMES)]
    step = 2 * window
    grid = step * np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1)
    points = tracks[first].keypoint_names
    joined = [_smooth(tracks[first], points, at, window)]
    found: dict[str, float] = {}
    for name in others:
        some = calibration.select([first, *found, name])

        def scale(offset: float, name: str = name, some: Calibration = some) -> float:
            pixels, trust = zip(*joined, _smooth(tracks[name], points, at + offset, window), strict=True)
            return triangulate(some, np.stack(pixels, 1), np.stack(trust, 1)).scale

        values = np.log([scale(offset) for offset in grid])
        best = int(values.argmin())
        freedom = len(at) * len(points) * (2 * len(some) - 3) / CORRELATED
        if (np.median(values) - values[best]) * np.sqrt(2 * freedom) < LEAST:
            raise InputError(f"tracks of camera {name!r} fit alike at all offsets: nothing moves enough to tell one")
        if best in (0, len(grid) - 1):
            raise InputError(f"camera {name!r} seems to be off by more than {reach:g} s: let the films begin together")
        around = (grid[best - 1], grid[best + 1])
        found[name] = float(minimize_scalar(scale, bounds=around, method="bounded", options={"xatol": step / 200}).x)
        joined.append(_smooth(tracks[name], points, at + found[name], window))
        if progress:
            progress(len(found), len(others), "offsets")
    return found


def _smooth(track: Recording, names: tuple[str, ...], at: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (T·P, 2) under a Gaussian window at times (T,), NaN beside a gap, and mean confidences (T·P,)."""
    order = [track.keypoint_names.index(name) for name in names]
    near = np.exp(-0.5 * ((at[:, None] - track.time) / window) ** 2)
    pixels = track.keypoints[:, order]
    trust = np.ones(pixels.shape[:2]) if track.confidence is None else np.nan_to_num(track.confidence[:, order])
    seen = np.isfinite(pixels).all(-1)
    weight = np.einsum("at,tp->ap", near, seen)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.einsum("at,tps->aps", near, np.where(seen[..., None], pixels, 0.0)) / weight[..., None]
        trust = np.einsum("at,tp->ap", near, np.where(seen, trust, 0.0)) / weight
    whole = np.sqrt(2 * np.pi) * window / track.frame_interval  # of a window without a gap
    mean[weight < 0.95 * whole] = np.nan
    return mean.reshape(-1, 2), np.nan_to_num(trust).ravel()
