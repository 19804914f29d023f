"""Coordinates of a body in space from its keypoints, by an iterated extended Kalman smoother.

    q' = q + δ q̇,   q̇' = q̇ + a √δ η,   y = r(q) + σ ν

with r(q) the tracked sites, and encoders where there are any (Bell and Cathey 1993, "The iterated Kalman filter update
as a Gauss–Newton method"; Rauch, Tung and Striebel 1965). Columns that are off by more than ``HUBER`` σ weigh less.

It begins where one row is best explained, which is searched from many poses. Poses that show the same points are
aliases: of a joint with yaw and pitch, yaw + π and π − pitch. The one whose pitches lie within a quarter turn is taken,
then the one nearest to zero: an alias has as good a density, and torques of another sign.

Shapes: rows (T, O), K coordinates, C candidates (agilities a, rad/s/√s); states (q, q̇) (C, 2 K).
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.body import Body
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.observation.observation import Observation

STARTS, LADDER = 64, 60
"""Poses that a search begins from, and its steps."""
NUDGE = 1e-5
"""Of a coordinate, rad or m, for slopes by central differences."""
PULL_SD = 10.0
"""Standard deviation of a coordinate about zero, rad or m: what no sensor sees stays there."""
HUBER, ROUNDS = 3.0, 3
"""Standard deviations beyond which a column weighs less, and times a row is linearised."""

Seen = Callable[[np.ndarray], np.ndarray]
"""From coordinates (..., K) to rows (..., O)."""


class Sighted:
    """A tree before its sensors: what it shows in a pose, against rows.

    Attributes:
        rows: (T, O) of pixels, keypoints and encoders, NaN where missing.
        noise: (O,) of each column.
        encoded: (T, K) what encoders read of coordinates, NaN where there are none.
    """

    def __init__(self, body: Body, observations: Tensor, observation: Observation, numbers: Any, sd: np.ndarray):
        self.body, self.numbers, self.dynamics = body, numbers, dynamics_for(body)
        self.pixels, self.keypoints, self.encoders = observation.pixels, observation.keypoints, observation.encoders
        every = observations.detach().cpu().double().numpy()
        known = [each for each in (self.pixels, self.keypoints, self.encoders) if each is not None]
        parts = [every[:, observation.part(each)] for each in known]
        self.rows = np.concatenate([every[:, :0], *parts], 1)
        off = float((sd * self.dynamics.levers(numbers).numpy()).max()) / 1.5
        points = np.full(0 if self.keypoints is None else int(np.prod(self.keypoints.shape)), off)
        if self.pixels is not None:
            size = int(np.prod(self.pixels.shape))
            points = np.concatenate([np.full(size, off / self.pixels.resolution), points])
        # A perfect simulation has no noise, but its slopes have rounding.
        self.noise = np.maximum(np.concatenate([points, sd if self.encoders else []]), 1e-6)
        self.encoded = parts[-1] if self.encoders else np.full((len(every), len(sd)), np.nan)

    def seen(self, q: np.ndarray) -> np.ndarray:
        """Rows (..., O) of coordinates (..., K)."""
        angles, parts = torch.as_tensor(q), []
        if self.pixels is not None:
            parts.append(self.pixels.about(self.dynamics.keypoints(angles, self.numbers)))
        if self.keypoints is not None:
            parts.append(self.keypoints.tracked(self.dynamics.keypoints(angles, self.numbers)).flatten(-2))
        return torch.cat([*parts, *([angles] if self.encoders else [])], -1).numpy()


def pose_candidates(
    body: Body,
    time: np.ndarray,
    observations: Tensor,
    observation: Observation,
    numbers: Any,
    sd: np.ndarray,
    agility: Sequence[float],
) -> np.ndarray | None:
    """Smoothed coordinates (C, T, K) of a tree; None where neither a keypoint nor an encoder is seen."""
    sighted = Sighted(body, observations, observation, numbers, sd)
    if not np.isfinite(sighted.rows).any():
        return None
    pose = first_pose(body, sighted.rows, sighted.seen, sighted.noise, sighted.encoded)
    return tracked(time, sighted.rows, sighted.seen, sighted.noise, np.asarray(agility), pose)


def row_poses(
    body: Body,
    observations: Tensor,
    observation: Observation,
    numbers: Any,
    sd: np.ndarray,
    near: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (T, K) that explain each row by itself, from those it is ``near`` (T, K); whether all of it is seen.

    What a row does not tell stays where it was.
    """
    sighted = Sighted(body, observations, observation, numbers, sd)
    poses, _ = fitted_poses(sighted.rows, sighted.seen, sighted.noise, near, near)
    return poses, np.isfinite(sighted.rows).all(1)


def first_pose(body: Body, rows: np.ndarray, seen: Seen, noise: np.ndarray, encoded: np.ndarray) -> np.ndarray:
    """Coordinates (K,) of the row that shows most, of its aliases the plainest one.

    ``encoded`` (T, K) are coordinates as encoders read them, NaN where there is none; what they read has no aliases.
    """
    most = np.isfinite(rows).sum(1).argmax()
    row, read = rows[most], encoded[most]
    turns = np.array([motion.turns for _, motion in body.motions()])
    starts = np.random.default_rng(0).uniform(-np.pi, np.pi, (STARTS, len(turns))) * turns
    starts[0] = 0.0
    starts = np.where(np.isfinite(read), read, starts)
    poses, cost = fitted_poses(row, seen, noise, starts, np.zeros(len(turns)))
    poses = np.where(turns & np.isnan(read), (poses + np.pi) % (2 * np.pi) - np.pi, poses)
    equal = poses[cost <= 1.1 * cost.min() + 5.0]
    return min(equal, key=lambda pose: (beyond(body, pose), np.abs(pose).sum()))


def beyond(body: Body, pose: np.ndarray) -> int:
    """How many joints of several turns a pose (K,) takes past the poles of their angles."""
    count = place = 0
    for link in body.links:
        motions, chart = link.joint.motions(), link.joint.chart
        if len(chart) > 1:
            middle = pose[place + len(motions) - len(chart) + 1]
            count += middle < 0 if len(chart) == 3 and chart[0] == chart[2] else abs(middle) > np.pi / 2
        place += len(motions)
    return count


def tracked(
    time: np.ndarray, rows: np.ndarray, seen: Seen, noise: np.ndarray, agility: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """Smoothed coordinates (C, T, K) of ``rows`` with noise (O,), for each agility (C,), from a pose (K,)."""
    steps, count, C = len(rows), len(pose), len(agility)
    unit, none = np.eye(count), np.zeros((count, count))
    mean = np.tile(np.concatenate([pose, np.zeros(count)]), (C, 1))
    cov = np.tile(np.block([[unit, none], [none, 400.0 * unit]]), (C, 1, 1))
    filtered, predicted = [], []
    for t in range(steps):
        if t > 0:
            F, Q = _motion(time[t] - time[t - 1], agility, count)
            mean, cov = mean @ F.T, F @ cov @ F.T + Q
        predicted.append((mean, cov))
        mean, cov = _updated(mean, cov, rows[t], seen, noise)
        filtered.append((mean, cov))
    means, covs = (np.stack([each[k] for each in filtered]) for k in (0, 1))
    ahead, wide = (np.stack([each[k] for each in predicted]) for k in (0, 1))
    F = np.stack([_motion(dt, agility, count)[0] for dt in np.diff(time)] or [np.zeros((0, 0))])
    if steps > 1:
        gains = np.linalg.solve(wide[1:], F[:, None] @ covs[:-1]).swapaxes(-1, -2)
        for t in range(steps - 2, -1, -1):
            means[t] += (gains[t] @ (means[t + 1] - ahead[t + 1])[..., None])[..., 0]
    return means[..., :count].swapaxes(0, 1)


def _motion(dt: float, agility: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """F (2 K, 2 K) and Q (C, 2 K, 2 K) of nearly constant velocity over dt s."""
    unit = np.eye(count)
    F = np.kron([[1.0, dt], [0.0, 1.0]], unit)
    Q = np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], unit)
    return F, agility[:, None, None] ** 2 * Q


def _updated(
    mean: np.ndarray, cov: np.ndarray, row: np.ndarray, seen: Seen, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """States (C, 2 K) with a row (O,) taken in, linearised again at the result."""
    known, count = np.isfinite(row), mean.shape[-1] // 2
    if not known.any():
        return mean, cov
    at = mean
    for _ in range(ROUNDS):
        here, slopes = _with_slopes(seen, at[:, :count])
        off = (row - here)[:, known]
        H = np.concatenate([slopes[:, known], np.zeros((len(mean), known.sum(), count))], -1)
        size = np.abs(off) / noise[known]
        variance = noise[known] ** 2 * np.maximum(size / HUBER, 1.0)
        crossed = cov @ H.swapaxes(-1, -2)
        inner = H @ crossed + np.eye(known.sum()) * variance[:, None]
        gain = np.linalg.solve(inner, crossed.swapaxes(-1, -2)).swapaxes(-1, -2)
        innovation = off - (H @ (mean - at)[..., None])[..., 0]
        new = mean + (gain @ innovation[..., None])[..., 0]
        done = np.abs(new - at)[:, :count].max() < 1e-3
        at = new
        if done:
            break
    cov = cov - gain @ crossed.swapaxes(-1, -2)
    return at, (cov + cov.swapaxes(-1, -2)) / 2


def _with_slopes(seen: Seen, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows (..., O) at q (..., K) and slopes (..., O, K)."""
    nudges = NUDGE * np.eye(q.shape[-1])
    ends = q[..., None, :] + np.concatenate([np.zeros((1, len(nudges))), nudges, -nudges])
    values = seen(ends)
    up, down = np.split(values[..., 1:, :], 2, axis=-2)
    return values[..., 0, :], ((up - down) / (2 * NUDGE)).swapaxes(-1, -2)


def fitted_poses(
    rows: np.ndarray,
    seen: Seen,
    noise: np.ndarray,
    starts: np.ndarray,
    about: np.ndarray,
    steps: int = LADDER,
    least_gain: float = -1.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Poses (S, K) that explain a row (O,), or one (S, O) each, by Levenberg and Marquardt from starts; costs (S,).

    What no sensor sees stays within ``PULL_SD`` ``about`` a pose. ``starts`` (S, K) and ``noise`` (O,). A search ends
    after so many ``steps``, or where no start's cost falls by ``least_gain``.
    """
    known = np.isfinite(rows)
    poses, damping = starts.copy(), np.full(len(starts), 1.0)

    def off(here: np.ndarray) -> np.ndarray:
        return np.where(known, (rows - here) / noise, 0.0)

    def cost(off: np.ndarray, q: np.ndarray) -> np.ndarray:
        return (off**2).sum(-1) + ((q - about) ** 2).sum(-1) / PULL_SD**2

    for _ in range(steps):
        here, slopes = _with_slopes(seen, poses)
        J = np.where(known[..., None], slopes / noise[:, None], 0.0)
        JJ = J.swapaxes(-1, -2) @ J + np.eye(poses.shape[1]) / PULL_SD**2
        widened = JJ + damping[:, None, None] * np.eye(JJ.shape[-1]) * np.trace(JJ, axis1=-2, axis2=-1)[:, None, None]
        pull = (J.swapaxes(-1, -2) @ off(here)[..., None])[..., 0] - (poses - about) / PULL_SD**2
        moved = poses + np.linalg.solve(widened, pull[..., None])[..., 0]
        gain = cost(off(here), poses) - cost(off(seen(moved)), moved)
        better = gain > 0
        poses = np.where(better[:, None], moved, poses)
        damping = np.where(better, damping / 5, damping * 5).clip(1e-12, 1e6)
        if ((gain < least_gain) & (better | (damping > 1))).all():
            break
    return poses, cost(off(seen(poses)), poses)
