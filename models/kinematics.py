"""Angles from what was observed, as a start for linearisation and for the first frame's prior.

Encoders tell the joints' coordinates of any body. Of a tree in space :mod:`.inverse_kinematics` finds them. Of a chain
in the plane keypoints do too: with tip k−1
and tip k both seen, link k points along their difference, so its absolute angle φ_k is
an arctangent, known up to whole turns; joints are taken to begin within half a turn. A Kalman filter
with nearly constant angular velocity,

    φ' = φ + δ ω,   ω' = ω + q √δ η,   measured φ wrapped to within half a turn of its prediction,

unwraps it where plain frame-to-frame unwrapping slips (fast limbs, coarse frames, noise), and its
Rauch–Tung–Striebel smoother bridges what was not seen. Several q are tried side by side. An outlying
detection can throw ω so far that φ then gains whole turns from frame to frame, which a camera
cannot deny: where that happens, and need not, what is far from its prediction is left out. None
of this enters the likelihood.

Shapes: observation rows (T, O), K links, C candidates (values of q, rad/s/√s).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.inverse_kinematics import pose_candidates
from invdyn.models.observation.observation import Observation

AGILITY = (1.0, 4.0, 16.0, 64.0, 256.0)
"""q, rad/s/√s, from a slow robot to a whirling limb: a prior about limbs, for any gravity and lengths."""
GATE = 4.0
"""Standard deviations from its prediction beyond which an angle is left out, where an outlier matters."""


def link_angles(observations: Tensor, observation: Observation, body: BodyParameters) -> tuple[np.ndarray, np.ndarray]:
    """Measured absolute link angles (T, K) of a planar chain, rad, NaN where not seen; and which are wrapped.

    Those of encoders (whole turns counted) where they exist, else of the camera: wrapped, in (−π, π].
    """
    rows = observations.detach().cpu().double().numpy()
    joints = body.length.shape[-1]
    absolute = np.full((len(rows), joints), np.nan)
    if observation.tracked:
        points = observation.points(rows)
        tips = np.full((len(rows), joints + 1, points.shape[-1]), np.nan)
        tips[:, 0] = body.base.detach().cpu().double().reshape(-1, points.shape[-1])[0].numpy()
        tips[:, np.asarray(observation.tracked) + 1] = points
        along = np.diff(tips, axis=1)
        absolute = np.arctan2(along[..., 1], along[..., 0])
    if not observation.encoders:
        return absolute, np.ones(absolute.shape, dtype=bool)
    encoders = np.cumsum(observation.of(observation.encoders, rows), axis=1)
    unread = np.isnan(encoders)
    return np.where(unread, absolute, encoders), unread


def smooth_angles(
    time: np.ndarray,
    measured: np.ndarray,
    sd: np.ndarray,
    agility: Sequence[float] | np.ndarray = AGILITY,
    wrap: bool | np.ndarray = True,
    gate: float = np.inf,
) -> np.ndarray:
    """Smoothed angles (C, T, K) of ``measured`` (T, K) with noise ``sd`` (K,), for each agility.

    ``wrap``, one for all or (T, K): whether an angle is known but for whole turns, as a camera's is. What is off its
    prediction by more than ``gate`` standard deviations is left out.
    """
    wrap = np.broadcast_to(wrap, measured.shape)
    q = np.asarray(agility, dtype=float)[:, None] ** 2
    steps, links = measured.shape
    shape = (len(agility), links)
    first = np.array([_first_seen(column) for column in measured.T])
    angle, rate = np.broadcast_to(first, shape).copy(), np.zeros(shape)
    a, b, c = np.full(shape, np.pi**2), np.zeros(shape), np.full(shape, 400.0)  # variances: φφ, φω, ωω
    filtered, predicted = np.zeros((steps, 5, *shape)), np.zeros((steps, 5, *shape))
    for t in range(steps):
        if t > 0:
            dt = time[t] - time[t - 1]
            angle = angle + dt * rate
            a, b, c = a + 2 * dt * b + dt**2 * c + q * dt**3 / 3, b + dt * c + q * dt**2 / 2, c + q * dt
        predicted[t] = angle, rate, a, b, c
        innovation = measured[t] - angle
        innovation = np.where(wrap[t], (innovation + np.pi) % (2 * np.pi) - np.pi, innovation)
        seen = np.abs(innovation) < gate * np.sqrt(a + sd**2)
        known, innovation = np.where(seen, 1 / (a + sd**2), 0.0), np.where(seen, innovation, 0.0)
        gain, other = a * known, b * known
        angle, rate = angle + gain * innovation, rate + other * innovation
        a, b, c = a - gain * a, b - gain * b, c - other * b
        filtered[t] = angle, rate, a, b, c
    # Smoother gains P Fᵀ P⁻¹ of the 2×2 systems, written out.
    dt = np.diff(time)[:, None, None]
    (a, b, c), (A, B, C) = (np.moveaxis(each, 1, 0) for each in (filtered[:-1, 2:], predicted[1:, 2:]))
    cross, inverse = np.array([[a + dt * b, b], [b + dt * c, c]]), np.array([[C, -B], [-B, A]]) / (A * C - B**2)
    gains = np.einsum("ijt...,jkt...->tik...", cross, inverse)
    smooth = filtered[:, :2].copy()
    for t in range(steps - 2, -1, -1):
        smooth[t] += (gains[t] * (smooth[t + 1] - predicted[t + 1, :2])).sum(1)
    return np.moveaxis(smooth[:, 0], 0, 1)


def _first_seen(column: np.ndarray) -> float:
    seen = np.flatnonzero(np.isfinite(column))
    return float(column[seen[0]]) if len(seen) else np.nan


def joint_angle_candidates(
    body: ArticulatedBody,
    time: np.ndarray,
    observations: Tensor,
    observation: Observation,
    numbers: Any,
    sd: np.ndarray,
) -> np.ndarray | None:
    """Smoothed joint angles (C, T, K), rad, of a body with these ``numbers``; None when some joint is never seen.

    ``sd`` (K,): noise of the measured angles, rad. Of a body of one's own encoders alone tell angles.
    """
    if not isinstance(body, Body):
        if not observation.encoders:
            return None
        measured = observation.of(observation.encoders, observations.detach().cpu().double().numpy())
        return smooth_angles(time, measured, sd, wrap=False) if np.isfinite(measured).any(axis=0).all() else None
    if not body.is_chain:
        return pose_candidates(body, time, observations, observation, numbers, sd, AGILITY)
    absolute, wrapped = link_angles(observations, observation, numbers)
    if not np.isfinite(absolute).any(axis=0).all():
        return None
    smooth = smooth_angles(time, absolute, sd, wrap=wrapped)
    whirls = _whirls(smooth) & wrapped.all(axis=0)
    if whirls.any():
        gated = smooth_angles(time, absolute, sd, wrap=wrapped, gate=GATE)
        smooth = np.where(whirls & ~_whirls(gated), gated, smooth)
    return within_half_a_turn(np.diff(smooth, axis=-1, prepend=0.0), wrapped)


def _whirls(angles: np.ndarray) -> np.ndarray:
    """Whether angles (C, T, K) turn by more than half a turn from one row to the next, (C, 1, K)."""
    return np.any(np.abs(np.diff(angles, axis=1)) > np.pi, axis=1, keepdims=True)


def within_half_a_turn(angles: np.ndarray, wrapped: np.ndarray) -> np.ndarray:
    """Joint angles (..., T, K) less whole turns: those that no encoder counted begin in [−π, π], as joints do.

    Two links in that range may be up to a turn apart. ``wrapped`` (T, K) as of :func:`link_angles`.
    """
    turns = np.round(angles[..., :1, :] / (2 * np.pi))
    return angles - 2 * np.pi * np.where(wrapped.all(axis=0), turns, 0.0)
