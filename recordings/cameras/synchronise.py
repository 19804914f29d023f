"""By how much each camera's clock runs ahead of the first one's, from the tracks alone.

A camera whose stamps are off sees a limb where it is not yet, or no more: its rays miss those of the others, the faster
the limb the more. Cameras join one after the other; the offset of the one that joins makes σ, the scale of a pixel's
error that `triangulate` finds, least: first over a grid of two frame intervals, then by Brent's method between the best
point's neighbours. For fractions of a frame all tracks pass one Gaussian window of one frame interval: interpolation
alone would average noise away halfway between frames, and draw the offset there. Without motion σ hardly depends on
the offset, and nothing is found.

A tracker that sets a limb off along a steady motion, and for long, looks like a clock that is off: 17 px of a walker
are 50 ms. So what each keypoint is off by in each view, over the whole film (the median), is taken away first, and what
is left of the motion, where it changes, tells the offset. How surely, keypoints tell that err each in its own
way: with the robust misfit of keypoint p, f_p(o), about the best offset,

    sd² = P/(P − 1) Σ_p f_p′² / (Σ_p f_p″)²

(the sandwich estimator with keypoints as clusters: Liang and Zeger, Biometrika 73, 1986). Derivatives by differences
over a frame interval.
"""

import warnings
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from ..errors import InputError
from ..recording import Recording
from .camera import Calibration
from .triangulate import FREEDOM, Triangulated, triangulate

MOST_FRAMES = 150
"""Frames that are looked at, spread over the film."""
CORRELATED = 4
"""Neighbouring frames under a window that count as one."""
FINEST = 0.05
"""Of a frame interval: what the window and straight lines between frames distort, whatever keypoints say."""
SURELY = 3.0
"""Standard deviations from zero that an offset is told by."""
LEAST = 5.0
"""By how many of its standard deviations log σ must dip."""


class Clock(NamedTuple):
    """By how much a camera's stamps run ahead, s, and the standard deviation of that; infinite where nothing tells."""

    seconds: float
    sd: float

    @property
    def sure(self) -> bool:
        """Whether it surely runs ahead, or behind."""
        return abs(self.seconds) > SURELY * self.sd


def find_offsets(
    tracks: Mapping[str, Recording],
    calibration: Calibration,
    reach: float = 0.25,
    progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, Clock]:
    """Offsets of all cameras but the first; what is sure of them is for `at_one_time`.

    A camera whose offset is not sure joins the others as if it had none.

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
    found: dict[str, Clock] = {}
    for name in others:
        some = calibration.select([first, *found, name])

        def seen(offset: float, name: str = name) -> tuple[np.ndarray, np.ndarray]:
            pixels, trust = zip(*joined, _smooth(tracks[name], points, at + offset, window), strict=True)
            return np.stack(pixels, 1), np.stack(trust, 1)

        def scale(offset: float, seen: Seen = seen, some: Calibration = some) -> float:
            return _levelled(some, *seen(offset), len(points)).scale

        values = np.log([scale(offset) for offset in grid])
        best = int(values.argmin())
        freedom = len(at) * len(points) * (2 * len(some) - 3) / CORRELATED
        if (np.median(values) - values[best]) * np.sqrt(2 * freedom) < LEAST:
            raise InputError(
                f"tracks of camera {name!r} fit alike at all offsets: nothing moves enough, or the tracker errs "
                "too much, to tell one"
            )
        if best in (0, len(grid) - 1):
            raise InputError(f"camera {name!r} seems to be off by more than {reach:g} s: let the films begin together")
        around = (grid[best - 1], grid[best + 1])
        least = minimize_scalar(scale, bounds=around, method="bounded", options={"xatol": step / 200})
        found[name] = Clock(float(least.x), _sd(some, seen, float(least.x), float(least.fun), window, len(points)))
        joined.append(_smooth(tracks[name], points, at + found[name].seconds * found[name].sure, window))
        if progress:
            progress(len(found), len(others), "offsets")
    return found


Seen = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""From an offset, s, to pixels (T·P, C, 2) and confidences (T·P, C)."""


def _levelled(
    some: Calibration, pixels: np.ndarray, trust: np.ndarray, points: int, scale: float | None = None
) -> Triangulated:
    """Points of pixels less what each of the ``points`` keypoints is off by in each view in the middle."""
    off = triangulate(some, pixels, trust, scale).residuals.reshape(-1, points, len(some), 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a view without a keypoint has no middle
        middle = np.nan_to_num(np.nanmedian(off, axis=0))
    return triangulate(some, pixels - np.tile(middle, (len(off), 1, 1)), trust, scale)


def _sd(some: Calibration, seen: Seen, offset: float, scale: float, step: float, points: int) -> float:
    """Standard deviation of an offset, s, at which a pixel's error has its least ``scale``; see above."""

    def misfits(by: float) -> np.ndarray:
        """(P,), of each keypoint."""
        pixels, trust = seen(by)
        off = _levelled(some, pixels, trust, points, scale).residuals
        terms = trust * np.log1p(np.square(off).sum(-1) / (FREEDOM * scale**2))
        return 0.5 * (FREEDOM + 2) * np.nansum(terms.reshape(-1, points, len(some)), axis=(0, 2))

    return float(np.hypot(spread(misfits, offset, step), FINEST * step))


def spread(misfits: Callable[[float], np.ndarray], offset: float, step: float) -> float:
    """Sd, s, of an offset at which misfits (P,) of clusters are least together; infinite where nothing tells."""
    before, here, after = (misfits(offset + side * step) for side in (-1, 0, 1))
    slope, bend = (after - before) / (2 * step), (after + before - 2 * here).sum() / step**2
    if len(here) < 2 or bend <= 0:
        return np.inf
    return float(np.sqrt(len(here) / (len(here) - 1) * np.square(slope).sum()) / bend)


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
