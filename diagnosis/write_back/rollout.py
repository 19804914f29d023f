"""A file's own simulation against a log: MuJoCo loads it, replays the commands, and what it is off by is counted.

The log is cut into windows of `replay_window` s. Each starts from the state x that the file itself is consistent with:
the most probable one of the window's angles y under the file's dynamics f, with the local cubic's x̂ as a prior,

    min over x   Σ_rows ((y − f(x))/σ)² + ((x − x̂)/s)²         (Gauss–Newton; multiple shooting, Bock & Plitt 1984)

so that no file pays for another's smoothing: an unstable arm multiplies an error of its start by e^{λt}. The whole log
is replayed, too, from its first state: that says how far an engine gets by itself.

σ are the angles' noise and s what it makes of a local cubic; cross-validation says how many rows that spans. A file
that says a joint has a delay keeps its past across a window.

Shapes: T rows, K joints.
"""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.models.bodies.joint_parts_mjcf import actuators_of, joint_names
from invdyn.models.bodies.mujoco_warnings import kept_warnings
from invdyn.recordings import InputError, Recording


@dataclass(frozen=True)
class Rollout:
    """What a file's simulation is off by, rms: each joint's angle, rad, by name; in so many windows.

    `whole` is the same of all joints where it is never restarted, rad; infinite where it runs away.
    """

    angle_rms: dict[str, float]
    windows: int
    whole: float = float("nan")

    @property
    def total(self) -> float:
        """Of all joints, rad."""
        return float(np.sqrt(np.mean(np.square(list(self.angle_rms.values())))))


@dataclass(frozen=True)
class Commands:
    """What reaches a file's actuators and joints in each row: controls (T, nu) and torques applied (T, nv)."""

    control: np.ndarray
    applied: np.ndarray


def commands(model: Any, body: ArticulatedBody, recording: Recording) -> Commands:
    """A recording's commands in the terms of a ``mujoco.MjModel``; without a motor, a joint's torque is applied."""
    rows = recording.num_frames
    control, applied = np.zeros((rows, model.nu)), np.zeros((rows, model.nv))
    for joint, given in zip(body.joint_names, body.joint_parts, strict=True):
        parts, column = given or NOTHING, recording.joint_names.index(joint)
        number = joint_names(model).index(joint)
        own = actuators_of(mujoco, model, number)
        motor = parts.motor
        if recording.torques is None or not np.isfinite(recording.torques[:, column]).any():
            continue
        torque = recording.torques[:, column]
        if motor is None or len(own) != 1:
            applied[:, int(model.jnt_dofadr[number])] = parts.sign * torque
            continue
        gear, gain = float(model.actuator_gear[own[0], 0]), float(model.actuator_gainprm[own[0], 0])
        if motor.kind == "torque":
            control[:, own[0]] = parts.sign * torque / (gear * gain)
        else:
            # a servo's command is K c + u₀ (models.articulated.as_filed)
            target = (torque - motor.bias) / motor.gain
            target = target - parts.zero if motor.kind == "position" else target
            control[:, own[0]] = parts.sign * target * gear
    return Commands(control, applied)


def rollout(path: str, body: ArticulatedBody, time: np.ndarray, angle: np.ndarray, given: Commands) -> Rollout:
    """Replay commands in the simulation of a file, against angles (T, K) rad at times (T,), NaN where missing.

    Raises InputError where MuJoCo cannot read the file, or too few rows have angles.
    """
    engine = _Engine(path, body, time, given)
    own = [parts or NOTHING for parts in body.joint_parts]
    signs, zeros = np.array([parts.sign for parts in own]), np.array([parts.zero for parts in own])
    seen = signs * (angle - zeros)
    smooth = smoothed_states(time, seen)
    q, qd = smooth.q, smooth.qd
    rows = np.flatnonzero(np.isfinite(q).all(1))
    begin, last = int(rows[0]), len(time) - 1
    whole = engine.run(np.concatenate([q[begin], qd[begin]]), begin, last) - seen[begin + 1 :]
    engine.restart()
    every = max(2, round(FIXED.replay_window / float(np.median(np.diff(time)))))
    edges = [*range(begin, last, every), last]
    fitted = set(np.linspace(0, len(edges) - 2, min(len(edges) - 1, FIXED.max_replay_windows)).round().astype(int))
    off, windows = [], 0
    for n, (first, end) in enumerate(pairwise(edges)):
        if not np.isfinite(q[first]).all():
            continue
        start = np.concatenate([q[first], qd[first]])
        if n in fitted:
            start = engine.consistent(start, smooth, seen, first, end)
            windows += 1
        found = engine.run(start, first, end) - seen[first + 1 : end + 1]
        off += [found] if n in fitted else []
    every_row = np.concatenate(off) if off else np.empty((0, len(signs)))
    if np.isfinite(every_row).sum() < len(signs):
        raise InputError(f"{path}: too few rows with angles to replay the log in it")
    rms = [float(np.sqrt(np.nanmean(each**2))) for each in every_row.T]
    known = whole[np.isfinite(seen[begin + 1 :])]
    total = float(np.sqrt((known**2).mean())) if np.isfinite(known).all() else float("inf")
    return Rollout(dict(zip(body.joint_names, rms, strict=True)), windows, total)


class _Engine:
    """A file's simulation in MuJoCo under the commands of a log's rows."""

    def __init__(self, path: str, body: ArticulatedBody, time: np.ndarray, given: Commands):
        try:
            self.model = mujoco.MjModel.from_xml_path(path)
        except ValueError as error:
            raise InputError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
        hinges = [joint_names(self.model).index(joint) for joint in body.joint_names]
        self.at, self.of = self.model.jnt_qposadr[hinges], self.model.jnt_dofadr[hinges]
        self.time, self.given = time, given
        self.parts = max(1, int(np.ceil(float(np.median(np.diff(time))) / self.model.opt.timestep - 1e-6)))
        self.trial = mujoco.MjData(self.model)
        self.restart()

    def restart(self) -> None:
        """Forget the past."""
        self.data = mujoco.MjData(self.model)

    def run(self, state: np.ndarray, first: int, end: int, trial: bool = False) -> np.ndarray:
        """Angles of rows ``first`` + 1 to ``end`` (N, K) from a state (2K,) at row ``first``, in the file's counting.

        A ``trial`` leaves the past as it was. What runs away is infinite.
        """
        data, K = self.data, len(self.at)
        if trial:
            data = self.trial
            mujoco.mj_copyData(data, self.model, self.data)
        data.qpos[self.at], data.qvel[self.of] = state[:K], state[K:]
        found = np.empty((end - first, K))
        with kept_warnings(mujoco):  # a simulation that is thrown off shows in the error
            for row in range(first, end):
                data.ctrl[:], data.qfrc_applied[:] = self.given.control[row], self.given.applied[row]
                self.model.opt.timestep = (self.time[row + 1] - self.time[row]) / self.parts
                mujoco.mj_step(self.model, data, self.parts)
                found[row - first] = data.qpos[self.at]
        return np.where(np.abs(found) < FIXED.max_replay_angle, found, np.inf)

    def consistent(self, start: np.ndarray, smooth: "States", seen: np.ndarray, first: int, end: int) -> np.ndarray:
        """The state (2K,) at row ``first`` that explains the angles ``seen`` (T, K) until ``end`` best; see the top."""
        y = seen[first + 1 : end + 1]
        known = np.isfinite(y)
        prior = np.concatenate([smooth.q_sd, smooth.qd_sd])
        weight = np.broadcast_to(1 / smooth.noise, y.shape)[known]

        def left(x: np.ndarray) -> np.ndarray:
            model = self.run(x, first, end, trial=True)[known]
            own = weight * (np.where(np.isfinite(model), model, FIXED.max_replay_angle) - y[known])
            return np.concatenate([own, (x - start) / prior])

        x, off = start, left(start)
        for _ in range(FIXED.replay_rounds):
            # a tenth of what is not known of the state: small for the dynamics, large for rounding
            slopes = [(left(x + each) - off) / (0.1 * prior[k]) for k, each in enumerate(0.1 * np.diag(prior))]
            step = np.linalg.lstsq(np.stack(slopes, -1), -off, rcond=None)[0]
            for part in (1.0, 0.3, 0.1):
                tried = left(x + part * step)
                if (tried**2).sum() < (off**2).sum():
                    break
            else:
                return x
            x, off = x + part * step, tried
        return np.asarray(x)


@dataclass(frozen=True)
class States:
    """Smoothed angles and velocities (T, K), NaN before the first and after the last row that has angles.

    With the noise of the angles (K,), and three sds of what it makes of each.
    """

    q: np.ndarray
    qd: np.ndarray
    noise: np.ndarray
    q_sd: np.ndarray
    qd_sd: np.ndarray


def states(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles and velocities of :func:`smoothed_states`."""
    found = smoothed_states(time, angle)
    return found.q, found.qd


def smoothed_states(time: np.ndarray, angle: np.ndarray) -> States:
    """A joint's local cubic spans as many rows as predict a row that is left out best.

    Raises InputError where too few rows have all angles (T, K).
    """
    use = np.isfinite(angle).all(1)
    if use.sum() < FIXED.min_replay_rows:
        raise InputError(f"expected {FIXED.min_replay_rows} rows with all angles or more, got {use.sum()}")
    seen = time[use]
    step = float(np.median(np.diff(seen)))
    even = seen[0] + step * np.arange(int((seen[-1] - seen[0]) / step + 1e-6) + 1)
    found: list[list[np.ndarray]] = [[], []]
    sds: list[tuple[float, float, float]] = []
    for joint in angle[use].T:
        rows = np.interp(even, seen, joint)
        span = min((span for span in FIXED.cubic_spans if span <= len(even)), key=partial(_left_out, rows))
        weights = [savgol_coeffs(span, 3, deriv=order, delta=step) for order in (0, 1)]
        for order, columns in enumerate(found):
            smooth = savgol_filter(rows, span, 3, deriv=order, delta=step)
            columns.append(np.interp(time, even, smooth, np.nan, np.nan))
        noise = max(float(np.sqrt(_left_out(rows, span))), FIXED.min_replay_noise)
        of_angle, of_velocity = (3 * noise * float(np.linalg.norm(each)) for each in weights)
        sds.append((noise, of_angle, of_velocity))
    q, qd = (np.stack(columns, -1) for columns in found)
    noises, q_sd, qd_sd = np.array(sds).T
    return States(q, qd, noises, q_sd, qd_sd)


def _left_out(rows: np.ndarray, span: int) -> float:
    """Mean square of what a local cubic over ``span`` rows, without a row (T,), is off by there."""
    own = savgol_coeffs(span, 3)[span // 2]
    inner = slice(span // 2, len(rows) - span // 2)
    return float((((rows - savgol_filter(rows, span, 3)) / (1 - own))[inner] ** 2).mean())
