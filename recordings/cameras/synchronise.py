"""By how much each camera's clock runs ahead of the first one's, from the tracks alone.

A camera whose time stamps are wrong sees a limb at another moment: its rays miss those of the others, by more the
faster the limb moves. Cameras are added one after the other. The offset of each minimises σ, the scale of a pixel's
error that
`triangulate` estimates: first over a grid of two frame intervals, then by Brent's method between the best point's
neighbours. All tracks are smoothed by a Gaussian window of one frame interval, since interpolation alone averages noise
most halfway between frames, which would bias the offset to there. Without motion σ hardly depends on the offset, and an
error is raised.

A tracker's constant offset along a steady motion looks like a wrong clock: 17 px of a walker are 50 ms. So each
keypoint's median residual in each view is subtracted first, and changes of the motion determine the offset. Its
standard
deviation treats keypoints as independent: with the robust misfit of keypoint p, f_p(o), about the best offset,

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
from .triangulate import DEGREES_OF_FREEDOM, Triangulated, triangulate

MAX_FRAMES = 150
"""Frames that are used, evenly distributed over the film."""
CORRELATED_FRAMES = 4
"""Neighbouring frames under a window that count as one."""
INTERPOLATION_SD = 0.05
"""Standard deviation of an offset by the window and by interpolation alone, in frame intervals."""
SIGNIFICANT = 3.0
"""Standard deviations from zero of an offset that is reported."""
MIN_DIP = 5.0
"""Standard deviations by which the minimum of log σ must be below its median over the grid."""


class Clock(NamedTuple):
    """By how much a camera's stamps run ahead, s, and the standard deviation of that.

    Infinite where it is undetermined.
    """

    seconds: float
    sd: float

    @property
    def significant(self) -> bool:
        """Whether it differs significantly from zero."""
        return abs(self.seconds) > SIGNIFICANT * self.sd


def find_offsets(
    tracks: Mapping[str, Recording],
    calibration: Calibration,
    reach: float = 0.25,
    progress: Callable[[int, int, str], None] | None = None,
) -> dict[str, Clock]:
    """Offsets of all cameras but the first; what is significant of them is for `at_one_time`.

    A camera whose offset is not significant joins the others as if it had none.

    Args:
        tracks: camera → its tracks, pixels.
        calibration: the cameras.
        reach: s, how far off a clock may be; at most as long as the first film.
        progress: called as (done, total, what).

    Raises:
        InputError: a reach that is not positive or longer than the film, too little motion, or the best
            offset is farther than `reach`; as `triangulate`.
    """
    first, *others = tracks
    window = tracks[first].frame_interval
    at = tracks[first].time
    if not 0 < reach <= at[-1] - at[0]:
        raise InputError(f"a clock may be off by up to the film's length, {at[-1] - at[0]:.3g} s, got {reach:g} s")
    at = at[:: -(-len(at) // MAX_FRAMES)]
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
        freedom = len(at) * len(points) * (2 * len(some) - 3) / CORRELATED_FRAMES
        if (np.median(values) - values[best]) * np.sqrt(2 * freedom) < MIN_DIP:
            raise InputError(
                f"tracks of camera {name!r} fit equally well at all offsets: nothing moves enough, or the tracker errs "
                "too much"
            )
        if best in (0, len(grid) - 1):
            raise InputError(f"camera {name!r} seems to be off by more than {reach:g} s: let the films begin together")
        around = (grid[best - 1], grid[best + 1])
        least = minimize_scalar(scale, bounds=around, method="bounded", options={"xatol": step / 200})
        found[name] = Clock(float(least.x), _sd(some, seen, float(least.x), float(least.fun), window, len(points)))
        joined.append(_smooth(tracks[name], points, at + found[name].seconds * found[name].significant, window))
        if progress:
            progress(len(found), len(others), "offsets")
    return found


Seen = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""From an offset, s, to pixels (T·P, C, 2) and confidences (T·P, C)."""


def _levelled(
    some: Calibration, pixels: np.ndarray, trust: np.ndarray, points: int, scale: float | None = None
) -> Triangulated:
    """Points of pixels less the median residual of each of the ``points`` keypoints in each view."""
    off = triangulate(some, pixels, trust, scale).residuals.reshape(-1, points, len(some), 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a view without a keypoint has no middle
        middle = np.nan_to_num(np.nanmedian(off, axis=0))
    return triangulate(some, pixels - np.tile(middle, (len(off), 1, 1)), trust, scale)


def _sd(some: Calibration, seen: Seen, offset: float, scale: float, step: float, points: int) -> float:
    """Standard deviation of an offset, s, at which the ``scale`` of a pixel's error is least; see above."""

    def misfits(by: float) -> np.ndarray:
        """(P,), of each keypoint."""
        pixels, trust = seen(by)
        off = _levelled(some, pixels, trust, points, scale).residuals
        terms = trust * np.log1p(np.square(off).sum(-1) / (DEGREES_OF_FREEDOM * scale**2))
        return 0.5 * (DEGREES_OF_FREEDOM + 2) * np.nansum(terms.reshape(-1, points, len(some)), axis=(0, 2))

    return float(np.hypot(sandwich_sd(misfits, offset, step), INTERPOLATION_SD * step))


def sandwich_sd(misfits: Callable[[float], np.ndarray], offset: float, step: float) -> float:
    """Sd, s, of an offset at which misfits (P,) of clusters are least together; infinite where it is undetermined."""
    before, here, after = (misfits(offset + side * step) for side in (-1, 0, 1))
    slope, bend = (after - before) / (2 * step), (after + before - 2 * here).sum() / step**2
    if len(here) < 2 or bend <= 0:
        return np.inf
    return float(np.sqrt(len(here) / (len(here) - 1) * np.square(slope).sum()) / bend)


def _smooth(track: Recording, names: tuple[str, ...], at: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (T·P, 2) under a Gaussian window at times (T,), NaN next to a gap, and mean confidences (T·P,)."""
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
