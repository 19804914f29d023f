"""The second generator's camera and tracker: cubic paths, a pinhole in space, and trackers' quirks.

A frame stamped t shows, through the effects that are present and in this order,

    when     t' = t − δ + ρ y + jitter: a share of frames mistimed, by a normal or a uniform law of the same sd
    marker   near its point on the link; on tissue that follows as a spring and a damper of its own (damping ratio
             .7 to 1.5), κ z̈ + 2 ζ √κ ż + z = −κ p̈, stepped from rest
    optics   rotated in space about an upright axis and seen by a pinhole at a distance; rolled; scaled; a lens by
             r (1 + k₁ r²), or by the division model r / (1 − k₁ r²) (Fitzgibbon, CVPR 2001)
    tracker  noise by one of `LAWS`, perhaps σ √(1 + (slope |v|)²); labels exchanged for one to four frames in a row;
             outliers likewise for one to three, about the point or anywhere near the arm

Every effect draws from a stream of its own. Shapes: T frames, P = K + 1 points, the base and the K tips.
"""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from invdyn.blindcheck.camera import Effect
from invdyn.blindcheck.simulator import Trajectory

LAWS = {"normal": 0.3, "rounded": 0.2, "uneven": 0.2, "heavy": 0.15, "trailing": 0.15}
"""Noise laws and how often they are met: normal; half of the variance of rounding to pixels; keypoints of unequal
noise; Student's t of eight degrees of freedom; correlated from frame to frame by .1 to .25."""


def noise_law(seed: Sequence[int]) -> str:
    """The tracker's law of a reality."""
    return str(np.random.default_rng([*seed[:4], 101]).choice(list(LAWS), p=list(LAWS.values())))


def film(
    trajectory: Trajectory, time: np.ndarray, effects: Sequence[Effect], noise: float, seed: Sequence[int]
) -> np.ndarray:
    """Points (T, P, 2), m, as recorded at true times `time` (T,) s, with noise of sd `noise` m."""
    present = {name: (place, parameters) for name, place, parameters in effects}

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng([*seed, 2, *name.encode()])

    tracks = _through(trajectory.time, _markers(trajectory, present))
    early, late = trajectory.time[[0, -1]]
    when = np.repeat(_when(time, present, stream("timestamp_jitter"))[:, None], trajectory.points.shape[1], axis=1)
    seen = when
    for _ in range(5 if "rolling_shutter" in present else 1):
        seen = np.clip(seen, early, late)
        points = np.stack([tracks(seen[:, k])[:, k] for k in range(seen.shape[1])], axis=1)
        if "rolling_shutter" in present:
            seen = when + present["rolling_shutter"][1]["readout"] * points[..., 1]
    sd = np.full(points.shape[:2], noise)
    if "varying_noise" in present:
        speed = np.linalg.norm(np.stack([tracks(seen[:, k], 1)[:, k] for k in range(seen.shape[1])], axis=1), axis=-1)
        sd = noise * np.sqrt(1 + (present["varying_noise"][1]["slope_in_squares"] * speed) ** 2)
    points = _optics(points, present)
    points = points + sd[..., None] * _noise(points.shape, stream("noise"), seed)
    return _mistaken(points, present, stream)


def _through(time: np.ndarray, paths: np.ndarray) -> Callable[..., np.ndarray]:
    """Cubic spline through paths (N+1, …) at ``time`` (N+1,) s, and its derivatives; NaN where those whirl away."""
    whole = np.isfinite(paths).reshape(len(paths), -1).all(1)
    if whole.all():
        return CubicSpline(time, paths, axis=0)
    if whole.sum() < 2:
        return lambda when, order=0: np.full((len(when), *paths.shape[1:]), np.nan)
    smooth = CubicSpline(time[whole], paths[whole], axis=0)

    def through(when: np.ndarray, order: int = 0) -> np.ndarray:
        points = smooth(when, order)
        points[np.interp(when, time, ~whole) > 0] = np.nan
        return points

    return through


def _when(time: np.ndarray, present: Mapping, rng: np.random.Generator) -> np.ndarray:
    when = time - present["camera_latency"][1]["latency"] if "camera_latency" in present else time
    if "timestamp_jitter" in present:
        p = present["timestamp_jitter"][1]
        mistimed, off = rng.random(len(time)) < p["rate"], rng.standard_normal(len(time))
        if p.get("uniform"):
            off = rng.uniform(-np.sqrt(3), np.sqrt(3), len(time))
        when = when + mistimed * off * p["sd"] / np.sqrt(p["rate"])
    return when


def _markers(trajectory: Trajectory, present: Mapping) -> np.ndarray:
    """Paths (N+1, P, 2) of what is tracked."""
    paths = trajectory.points.copy()
    if "keypoint_offset" in present:
        k, p = present["keypoint_offset"]
        turn = np.exp(1j * trajectory.heading[:, k]) * (p["along"] + 1j * p["across"])
        paths[:, k + 1] += np.stack([turn.real, turn.imag], axis=-1)
    if "soft_tissue" in present:
        k, p = present["soft_tissue"]
        second = _through(trajectory.time, trajectory.points[:, k + 1])(trajectory.time, 2)
        paths[:, k + 1] += _sprung(trajectory.time[1] - trajectory.time[0], second, p["kappa"], p["damping_ratio"])
    return paths


def _sprung(h: float, acceleration: np.ndarray, kappa: float, ratio: float) -> np.ndarray:
    """Z (N+1, 2) of κ z̈ + 2 ζ √κ ż + z = −κ a, steady at first; a straight between steps, exact there."""
    # state (z, ż, a, ȧ); a grows at the rate that it has over the step
    system = np.zeros((4, 4))
    system[0, 1], system[1], system[2, 3] = 1.0, [-1 / kappa, -2 * ratio / np.sqrt(kappa), -1.0, 0.0], 1.0
    step = expm(h * system)[:2]
    state, path = np.stack([-kappa * acceleration[0], np.zeros(2)]), [-kappa * acceleration[0]]
    for a, after in pairwise(acceleration):
        state = step @ np.vstack([state, a, (after - a) / h])
        path.append(state[0])
    return np.array(path)


def _optics(points: np.ndarray, present: Mapping) -> np.ndarray:
    if "camera_yaw" in present:
        p = present["camera_yaw"][1]
        centre = np.array([p.get("centre_x", 0.0), p.get("centre_y", 0.0)])
        flat = points - centre
        in_space = np.concatenate([flat, np.zeros_like(flat[..., :1])], axis=-1)
        c, s = np.cos(p["angle"]), np.sin(p["angle"])
        rotated = in_space @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        points = centre + p["distance"] * rotated[..., :2] / (p["distance"] + rotated[..., 2:])
    if "camera_roll" in present:
        rolled = (points[..., 0] + 1j * points[..., 1]) * np.exp(1j * present["camera_roll"][1]["angle"])
        points = np.stack([rolled.real, rolled.imag], axis=-1)
    if "camera_scale" in present:
        points = present["camera_scale"][1]["scale"] * points
    if "lens_distortion" in present:
        p = present["lens_distortion"][1]
        centre = np.array([p.get("centre_x", 0.0), p.get("centre_y", 0.0)])
        square = ((points - centre) ** 2).sum(-1, keepdims=True)
        grown = 1 / (1 - p["division"] * square) if "division" in p else 1 + p["k1"] * square
        points = centre + (points - centre) * grown
    return points


def _noise(shape: tuple[int, ...], rng: np.random.Generator, seed: Sequence[int]) -> np.ndarray:
    """Noise (T, P, 2) of unit variance, over all keypoints."""
    law, own = noise_law(seed), np.random.default_rng([*seed[:4], 102])
    normal = rng.standard_normal(shape)
    if law == "rounded":  # as wide as the pixels are, the rest of a pixel is as good as random
        return np.sqrt(0.5) * (normal + rng.uniform(-np.sqrt(3), np.sqrt(3), shape))
    if law == "uneven":
        each = own.uniform(0.6, 1.5, shape[1])
        return normal * (each / np.sqrt((each**2).mean()))[:, None]
    if law == "heavy":
        return normal * np.sqrt(6 / rng.chisquare(8, shape[:2]))[..., None]
    if law == "trailing":
        memory = own.uniform(0.1, 0.25)
        for row in range(1, shape[0]):
            normal[row] = memory * normal[row - 1] + np.sqrt(1 - memory**2) * normal[row]
    return normal


def _mistaken(points: np.ndarray, present: Mapping, stream: Callable[[str], np.random.Generator]) -> np.ndarray:
    points = points.copy()
    if "label_swap" in present:
        place, p = present["label_swap"]
        one, other = (place or 0) + 1, place or 2  # a tip and its neighbour; the base is never mistaken
        swapped = _in_a_row(stream("label_swap"), (len(points), 1), p["rate"], p["in_a_row"])[:, 0]
        points[swapped, one], points[swapped, other] = points[swapped, other], points[swapped, one]
    if "outliers" in present:
        p, rng = present["outliers"][1], stream("outliers")
        outlying = _in_a_row(rng, points.shape[:2], p["rate"], p["in_a_row"])
        if "scale" in p:
            points += outlying[..., None] * p["scale"] * rng.standard_normal(points.shape)
        else:
            anywhere = points[:, :1] + rng.uniform(-p["within"], p["within"], points.shape)
            points = np.where(outlying[..., None], anywhere, points)
    return points


def _in_a_row(rng: np.random.Generator, shape: tuple[int, int], rate: float, most: float) -> np.ndarray:
    """Which entries (T, n) are mistaken, so many frames in a row, 1 to `most`, at a share of `rate` of all frames."""
    longest = int(most)
    starts = rng.random(shape) < rate / ((1 + longest) / 2)
    lengths = rng.integers(1, longest + 1, shape)
    mistaken = np.zeros(shape, dtype=bool)
    for late in range(longest):
        mistaken[late:] |= (starts & (lengths > late))[: len(starts) - late]
    return mistaken
