"""The camera, in numpy: when it looked, where the markers sat, what the lens made of them, what the tracker missed.

And encoders: angles, from where each counts.

A frame stamped t shows, through the effects that are present and in this order,

    when     t' = t − δ (latency) + ρ y (rolling shutter, y the row's height) + jitter: a share of the frames
             (rate) is mistimed, normally or uniformly, with a standard deviation of sd over all frames
    marker   p' = p + R(φ) (along, across)                  φ the link's absolute angle
             p' = p − κ a                                   soft tissue, a the keypoint's acceleration; or as it
             p' = p + δ,  δ̈ + 2ζω δ̇ + ω² δ = −a            swings, ω = 1/√κ
    optics   (x, y) → (x cos ψ, y) D / (D + x sin ψ)        yaw, from the distance D
             p' = R(angle) p,   p' = s p,   p' = p (1 + k₁ |p|²)      about the frame's origin, yaw and lens also about
             p' = p / (1 − k₁ |p|²)                         any centre; the division model: Fitzgibbon, CVPR 2001
    tracker  p + σ (1 + slope |v|) noise, or σ √(1 + (slope |v|)²);  two labels exchanged;  an outlier near p, or
             anywhere within reach; these for a frame, or for several in a row (:mod:`.tracker`)

The rate of the clock is no matter of the picture: it scales every time in the table, `cases` sees to it.

Shapes: T frames, P = K + 1 points, the base and the K tips.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.signal import cont2discrete, lfilter, lfilter_zi

from invdyn.blindcheck.tracker import mistaken, unit_noise
from invdyn.blindcheck.world import Trajectory

Effect = tuple[str, int | None, Mapping[str, float]]
"""Name, the keypoint's number (0 is the first tip) where it has one, and parameters."""


def film(
    trajectory: Trajectory,
    time: np.ndarray,
    effects: Sequence[Effect],
    noise: float,
    seed: Sequence[int],
    law: str = "normal",
) -> np.ndarray:
    """Points (T, P, 2), m, as recorded at true times `time` (T,) s, with noise of a `law` and of sd `noise` m.

    Every effect draws from a stream of its own, so that leaving one out, or noise 0, changes nothing else.
    """
    present = {name: (place, parameters) for name, place, parameters in effects}

    def stream(name: str) -> np.random.Generator:
        return np.random.default_rng([*seed, *name.encode()])

    tracks = np.stack([marker(trajectory, k, present) for k in range(trajectory.points.shape[1])], axis=1)
    when = np.repeat(capture_times(time, present, stream)[:, None], tracks.shape[1], axis=1)
    points = _at(trajectory.time, tracks, when)
    if "rolling_shutter" in present:
        per_metre = present["rolling_shutter"][1]["readout"]
        for _ in range(4):  # the row that a point is seen in depends on when: a contraction for ρ |v| ≪ 1
            points = _at(trajectory.time, tracks, when + per_metre * points[..., 1])
    points = optics(points, present)
    sd = np.full(points.shape[:2], noise)
    if "varying_noise" in present:
        velocity = np.gradient(tracks, trajectory.time, axis=0)
        speed = np.linalg.norm(_at(trajectory.time, velocity, when), axis=-1)
        grown = present["varying_noise"][1]
        squares = grown.get("slope_in_squares")
        sd = sd * (1 + grown["slope"] * speed if squares is None else np.sqrt(1 + (squares * speed) ** 2))
    points = points + sd[..., None] * unit_noise(points.shape, law, stream("noise"), seed)
    if "label_swap" in present:
        place, p = present["label_swap"]
        one, other = (place or 0) + 1, place or 2  # a tip and its neighbour; the base is never mistaken
        swapped = mistaken(stream("label_swap"), (len(points),), p["rate"], p.get("in_a_row", 1))
        points[np.ix_(swapped, np.array([one, other]))] = points[np.ix_(swapped, np.array([other, one]))]
    if "outliers" in present:
        p, rng = present["outliers"][1], stream("outliers")
        outlying = mistaken(rng, points.shape[:2], p["rate"], p.get("in_a_row", 1))[..., None]
        if "within" in p:
            anywhere = points[:, :1] + rng.uniform(-p["within"], p["within"], points.shape)
            points = np.where(outlying, anywhere, points)
        else:
            points += outlying * p["scale"] * rng.standard_normal(points.shape)
    return points


def capture_times(time: np.ndarray, present: Mapping, stream: Callable[[str], np.random.Generator]) -> np.ndarray:
    """When each frame (T,) was really taken, but for the rolling shutter."""
    when = time
    if "camera_latency" in present:
        when = when - present["camera_latency"][1]["latency"]
    if "timestamp_jitter" in present:
        parameters, rng = present["timestamp_jitter"][1], stream("timestamp_jitter")
        mistimed = rng.random(len(time)) < parameters["rate"]
        uniform = parameters.get("uniform")
        off = rng.uniform(-np.sqrt(3), np.sqrt(3), len(time)) if uniform else rng.standard_normal(len(time))
        when = when + mistimed * parameters["sd"] / np.sqrt(parameters["rate"]) * off
    return when


def marker(trajectory: Trajectory, point: int, present: Mapping) -> np.ndarray:
    """Track (N+1, 2) of the marker that stands for a point."""
    track = trajectory.points[:, point]
    if "keypoint_offset" in present and present["keypoint_offset"][0] == point - 1:
        parameters, heading = present["keypoint_offset"][1], trajectory.heading[:, point - 1]
        along = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        across = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        track = track + parameters["along"] * along + parameters["across"] * across
    if "soft_tissue" in present and present["soft_tissue"][0] == point - 1:
        parameters, a = present["soft_tissue"][1], acceleration(trajectory.time, trajectory.points[:, point])
        kappa, ratio = parameters["kappa"], parameters.get("damping_ratio")
        track = track + (-kappa * a if ratio is None else swung(trajectory.time, a, kappa, ratio))
    return track


def swung(time: np.ndarray, acceleration: np.ndarray, kappa: float, damping_ratio: float) -> np.ndarray:
    """δ (N+1, 2), m, of tissue on a point of so much acceleration (N+1, 2), m/s², on an even grid; steady at first."""
    swing = [-kappa], [kappa, 2 * damping_ratio * kappa**0.5, 1.0]
    above, below, _ = cont2discrete(swing, time[1] - time[0], "foh")
    state = np.outer(lfilter_zi(above[0], below), acceleration[0])
    return lfilter(above[0], below, acceleration, axis=0, zi=state)[0]


def acceleration(time: np.ndarray, track: np.ndarray) -> np.ndarray:
    """Second derivative (N+1, 2), m/s², by central differences."""
    return np.gradient(np.gradient(track, time, axis=0), time, axis=0)


def optics(points: np.ndarray, present: Mapping) -> np.ndarray:
    """What lens and pose of the camera make of points (..., 2), m."""
    if "camera_yaw" in present:
        angle, distance = (present["camera_yaw"][1][key] for key in ("angle", "distance"))
        centre = _centre(present["camera_yaw"][1])
        x, y = np.moveaxis(points - centre, -1, 0)
        rotated = np.stack([x * np.cos(angle), y], axis=-1)
        points = centre + rotated * (distance / (distance + x * np.sin(angle)))[..., None]
    if "camera_roll" in present:
        angle = present["camera_roll"][1]["angle"]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        points = points @ turn.T
    if "camera_scale" in present:
        points = points * present["camera_scale"][1]["scale"]
    if "lens_distortion" in present:
        p = present["lens_distortion"][1]
        from_it = points - (centre := _centre(p))
        square = (from_it**2).sum(axis=-1, keepdims=True)
        points = centre + from_it * (1 / (1 - p["division"] * square) if "division" in p else 1 + p["k1"] * square)
    return points


def _centre(parameters: Mapping[str, float]) -> np.ndarray:
    return np.array([parameters.get("centre_x", 0.0), parameters.get("centre_y", 0.0)])


def _at(time: np.ndarray, tracks: np.ndarray, when: np.ndarray) -> np.ndarray:
    """Tracks (N+1, P, 2) on an even grid at `when` (T, P), by local cubics (Catmull & Rom 1974)."""
    place = np.clip((when - time[0]) / (time[1] - time[0]), 0.0, len(time) - 1.0)
    low = np.minimum(place.astype(int), len(time) - 2)
    x, point = (place - low)[..., None], np.arange(tracks.shape[1])
    weights = -x + 2 * x**2 - x**3, 2 - 5 * x**2 + 3 * x**3, x + 4 * x**2 - 3 * x**3, x**3 - x**2
    near = (tracks[np.clip(low + n, 0, len(time) - 1), point] for n in (-1, 0, 1, 2))
    return np.asarray(sum(w * p for w, p in zip(weights, near, strict=True)) / 2)


def readings(trajectory: Trajectory, when: np.ndarray, effects: Sequence[Effect]) -> np.ndarray:
    """Angles (T, K), rad, without noise, at times `when` (T,) s."""
    angles = np.stack([np.interp(when, trajectory.time, column) for column in trajectory.q.T], axis=-1)
    for name, joint, parameters in effects:
        if name == "encoder_offset":
            angles[:, joint] += parameters["offset"]
    return angles
