"""What a recording says of motion and torque, as a regression takes it: smoothed angles, averaged torques.

Encoders, or angles that keypoints show, pass a Kalman smoother (:mod:`.wiener_smoother`). A torque is constant until
the next row. It is averaged over the time that a row stands for, half a step to each side, as the motion is. Servos
answer to the smoothed angle and velocity. A stiff one with limits goes from one to the other within a row, as its
target jumps: what it gives is the mean of min(max(u, low), high) at N moments of a row, and not that of the mean of u.

Shapes: T rows of a recording, R rows of a motion, K joints, N moments of a row. Units: rad, s, N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from invdyn.diagnosis.problem.angles import recorded_angles
from invdyn.diagnosis.problem.stretches import stretches
from invdyn.diagnosis.regression.wiener_smoother import SmoothedAngles, smooth
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.articulated.as_filed import answered
from invdyn.recordings import Recording


@dataclass(frozen=True)
class MeasuredMotion:
    """Posterior means (R, K) of angle, velocity and acceleration, their sds, and the torque (R, K).

    `demanded` (R, K) is K (c − q) of position servos, without limits and without their damping, whose torque is
    `servo_drag`; elsewhere it is `torque`. `within` (R, N, K) is what it differs by from that mean at moments of a row,
    N = 1 where no servo has limits. `torque_sd` is what noise in the encoders makes of a servo's torque. `command`
    (R, K) is that before servos answer. `stretch` (R,) counts pieces of a recording between which time jumps, and
    `recording` (R,) recordings.
    """

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    qd_sd: np.ndarray
    qdd_sd: np.ndarray
    torque: np.ndarray
    demanded: np.ndarray
    within: np.ndarray
    servo_drag: np.ndarray
    torque_sd: np.ndarray
    command: np.ndarray
    stretch: np.ndarray
    recording: np.ndarray

    @property
    def parts(self) -> np.ndarray:
        """(R,) which recording rows are of; of one recording, which third."""
        return self.recording if self.recording.any() else np.arange(len(self.time)) * 3 // len(self.time)

    def at(self, rows: np.ndarray | slice) -> "MeasuredMotion":
        """Some rows of it, by number, (R,) of bool or neighbouring ones."""
        return MeasuredMotion(**{name: values[rows] for name, values in vars(self).items()})


def measured_motion(
    recording: Recording | Sequence[Recording],
    body: ArticulatedBody,
    *,
    passive: bool = False,
    rules: Rules = DEFAULT,
) -> MeasuredMotion | None:
    """The motion of a recording, or of several one after the other; ``passive`` says that torques are zero.

    None where torques are not known, or too few rows show every joint. Raises InputError where keypoints do not fit
    the body.
    """
    if not isinstance(recording, Recording):
        each = [measured_motion(one, body, passive=passive, rules=rules) for one in recording]
        return _one_after_another([motion for motion in each if motion is not None])
    K, names = body.num_joints, recording.joint_names
    order = [names.index(name) for name in body.joint_names if name in names]
    if not passive and (recording.torques is None or len(order) < K):
        return None
    whole = (
        recorded_angles(recording, body) if recording.angles is None or len(order) < K else recording.angles[:, order]
    )
    torque = np.zeros_like(whole)
    if not passive and recording.torques is not None:
        torque = recording.torques[:, order]
    seen = np.isfinite(whole).any(1)
    if seen.sum() < rules.recording.min_rows or not np.isfinite(whole).any(0).all():
        return None
    pieces = stretches(recording, rules)
    bounds = [(piece.time[0], piece.time[-1]) for piece in pieces]
    parts = []
    every = max(1, int(np.ceil(seen.sum() / FIXED.max_regression_rows))) if len(pieces) == 1 else 1
    for low, high in bounds:
        inside = seen & (recording.time >= low) & (recording.time <= high)
        for rows in _without_gaps(recording.time, np.flatnonzero(inside)):
            if len(rows) >= rules.recording.min_rows * every:
                parts.append(_means(recording.time[rows], whole[rows], every))
    if not parts:
        return None
    made = [
        _of_stretch(number, each, recording.time, torque, body, passive) for number, each in enumerate(smooth(parts))
    ]
    motion = _joined(made)
    sharp = motion.qdd_sd <= FIXED.max_edge_sd * np.median(motion.qdd_sd, 0) + np.finfo(float).tiny
    known = sharp.all(1) & np.isfinite(motion.torque).all(1)
    pieces_known = [np.flatnonzero(known & (motion.stretch == number)) for number in range(len(made))]
    runs = [run for rows in pieces_known for run in _without_gaps(motion.time, rows)]
    runs = [run for run in runs if len(run) >= rules.recording.min_rows]
    split = [replace(motion.at(run), stretch=np.full(len(run), n)) for n, run in enumerate(runs)]
    return _joined(split) if split else None


def _one_after_another(motions: Sequence[MeasuredMotion]) -> MeasuredMotion | None:
    """Motions as stretches of one, a second apart."""
    moved, end, number = [], 0.0, 0
    for each, motion in enumerate(motions):
        time = motion.time - motion.time[0] + end
        where = np.full(len(time), each)
        moved.append(replace(motion, time=time, stretch=motion.stretch + number, recording=where))
        end, number = float(time[-1]) + 1.0, number + int(motion.stretch.max()) + 1
    return _joined(moved) if moved else None


def _joined(parts: Sequence[MeasuredMotion]) -> MeasuredMotion:
    """Rows of all."""
    return MeasuredMotion(**{name: np.concatenate([vars(p)[name] for p in parts]) for name in vars(parts[0])})


def _without_gaps(time: np.ndarray, rows: np.ndarray) -> list[np.ndarray]:
    """Runs of ``rows`` without a step far beyond the usual one."""
    if len(rows) < 2:
        return [rows]
    step = np.diff(time[rows])
    return np.split(rows, np.flatnonzero(step > FIXED.max_gap_steps * np.median(step)) + 1)


def _means(time: np.ndarray, angle: np.ndarray, every: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and angles averaged over so many rows each, where none of them is missing."""
    if every == 1:
        return time, angle
    count = len(time) // every
    shown = angle[: count * every].reshape(count, every, -1).mean(1)
    return time[: count * every].reshape(count, every).mean(1), shown


def _of_stretch(
    number: int,
    smoothed: SmoothedAngles,
    time: np.ndarray,
    torque: np.ndarray,
    body: ArticulatedBody,
    passive: bool,
) -> MeasuredMotion:
    q, qd, qdd = (np.ascontiguousarray(smoothed.mean[..., n]) for n in range(3))
    command = given = demanded = hold_mean(time, torque, smoothed.time)
    drag, within = servo_damping(body) * qd, np.zeros((len(q), 1, q.shape[1]))
    if not passive:
        demanded = _unlimited(body, command, q, qd) + drag
        if any(parts.servo is not None and parts.servo.limited for parts in body.joint_parts):
            within = _within_rows(time, torque, smoothed, body)
        given = limited(body, demanded - drag, within)
    sd = np.sqrt(np.maximum(np.einsum("tkii->tki", smoothed.covariance), 0.0))
    servos = [parts.servo for parts in body.joint_parts]
    answer = np.array([(0.0, 0.0) if servo is None else (servo.stiffness, servo.damping) for servo in servos])
    noise = np.einsum("ki,tkij,kj->tk", answer, smoothed.covariance[..., :2, :2], answer)
    torque_sd, where = np.sqrt(noise), np.full(len(q), number)
    torques = given, demanded, within, drag, torque_sd, command
    return MeasuredMotion(smoothed.time, q, qd, qdd, sd[..., 1], sd[..., 2], *torques, where, np.zeros_like(where))


def _unlimited(body: ArticulatedBody, *state: np.ndarray) -> np.ndarray:
    """Torques of motors under a command in states q, q̇, without limits."""
    command, q, qd = (torch.as_tensor(each) for each in state)
    return np.asarray(answered(body, command, q, qd, limited=False).numpy())


def _within_rows(time: np.ndarray, torque: np.ndarray, smoothed: SmoothedAngles, body: ArticulatedBody) -> np.ndarray:
    """What motors demand at N moments of each row (R, N, K), less its mean: q̈ is constant within a row."""
    edges, number = _edges(smoothed.time, time), FIXED.moments_of_a_row
    moments = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(number) + 0.5) / number
    q, qd, qdd = (smoothed.mean[:, None, :, n] for n in range(3))
    after = (moments - smoothed.time[:, None])[..., None]
    held = torque[np.searchsorted(time, moments, side="right") - 1]
    demanded = _unlimited(body, held, q + after * qd + 0.5 * after**2 * qdd, qd + after * qdd)
    return demanded - demanded.mean(1, keepdims=True)


def limited(body: ArticulatedBody, demanded: np.ndarray, within: np.ndarray) -> np.ndarray:
    """Means (R, K) over a row of what servos give of what they demand, (R, K), which differs ``within`` it (R, N, K).

    Of other joints all of it.
    """
    servos = [parts.servo for parts in body.joint_parts]
    bounds = [(-np.inf, np.inf) if servo is None else (servo.low, servo.high) for servo in servos]
    return np.asarray((demanded[:, None] + within).clip(*np.transpose(bounds)).mean(1))


def servo_damping(body: ArticulatedBody) -> np.ndarray:
    """D (K,) N·m·s/rad of position servos, 0 elsewhere."""
    return np.array([own.servo_damping for own in body.joint_parts])


def hold_mean(time: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Means (R, K) over the steps around times ``at`` (R,) of ``values`` (T, K), each constant until the next row.

    NaN where one that is not known, NaN, is part of it.
    """
    edges, unknown = _edges(at, time), np.isnan(values)

    def area(values: np.ndarray) -> np.ndarray:
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values[:-1] * np.diff(time)[:, None], 0)])
        return np.diff(np.stack([np.interp(edges, time, each) for each in total.T], -1), axis=0)

    mean = area(np.where(unknown, 0.0, values)) / np.maximum(np.diff(edges), 1e-12)[:, None]
    return np.where(area(unknown.astype(float)) > 0, np.nan, mean)


def _edges(at: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Bounds (R + 1,) of the steps around times ``at`` (R,) of a recording's ``time`` (T,)."""
    return np.concatenate([at[:1], (at[1:] + at[:-1]) / 2, at[-1:]]).clip(time[0], time[-1])
