"""A file's own simulation against a log: MuJoCo loads it, replays the commands, and what it is off by is counted.

The log is cut into windows of `replay_window` s. Each starts from the state x that the file itself is consistent with:
the most probable one of the window's angles y under the file's dynamics f, with a smoother's x̂ as a prior,

    min over x   Σ_rows ((y − f(x))/σ)² + ((x − x̂)/s)²         (Gauss–Newton; multiple shooting, Bock & Plitt 1984)

so that no file pays for another's smoothing: an unstable arm multiplies an error of its start by e^{λt}. The whole log
is replayed, too, from its first state: that says how far an engine gets by itself.

σ are the angles' noise and s three sds of x̂ (:mod:`..regression.wiener_smoother`). A file that says a joint has a
delay keeps its past across a window.

Shapes: T rows, K joints.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.regression.wiener_smoother import smooth
from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts_mjcf import actuators_of, joint_names, kept_warnings
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
    for joint, parts in zip(body.joint_names, body.joint_parts, strict=True):
        column = recording.joint_names.index(joint)
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
    signs, zeros = body.file_counting
    seen = signs * (angle - zeros)
    smoothed = smoothed_states(time, seen)
    known = np.isfinite(smoothed.mean).all(1)
    begin, last = int(known.argmax()), len(time) - 1
    whole = engine.run(smoothed.mean[begin], begin, last) - seen[begin + 1 :]
    engine.restart()
    every = max(2, round(FIXED.replay_window / float(np.median(np.diff(time)))))
    edges = [*range(begin, last, every), last]
    fitted = set(np.linspace(0, len(edges) - 2, min(len(edges) - 1, FIXED.max_replay_windows)).round().astype(int))
    off, windows = [], 0
    for n, (first, end) in enumerate(pairwise(edges)):
        if not known[first]:
            continue
        start = smoothed.mean[first]
        if n in fitted:
            start = engine.consistent(smoothed, seen, first, end)
            windows += 1
        found = engine.run(start, first, end) - seen[first + 1 : end + 1]
        off += [found] if n in fitted else []
    every_row = np.concatenate(off) if off else np.empty((0, len(signs)))
    if np.isfinite(every_row).sum() < len(signs):
        raise InputError(f"{path}: too few rows with angles to replay the log in it")
    rms = [float(np.sqrt(np.nanmean(each**2))) for each in every_row.T]
    off_whole = whole[np.isfinite(seen[begin + 1 :])]
    total = float(np.sqrt((off_whole**2).mean())) if np.isfinite(off_whole).all() else float("inf")
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

    def consistent(self, smoothed: "States", seen: np.ndarray, first: int, end: int) -> np.ndarray:
        """The state (2K,) at row ``first`` that explains the angles ``seen`` (T, K) until ``end`` best; see the top."""
        y = seen[first + 1 : end + 1]
        known = np.isfinite(y)
        start, prior = smoothed.mean[first], smoothed.sd[first]
        weight = np.broadcast_to(1 / smoothed.noise, y.shape)[known]

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
    """Smoothed angles and velocities (T, 2K), with three sds of each, and the noise of the angles (K,).

    NaN before the first and after the last row that has angles.
    """

    mean: np.ndarray
    sd: np.ndarray
    noise: np.ndarray


def smoothed_states(time: np.ndarray, angle: np.ndarray) -> States:
    """What angles (T, K) say of a motion. Raises InputError where too few rows have all."""
    use = np.flatnonzero(np.isfinite(angle).all(1))
    if len(use) < FIXED.min_replay_rows:
        raise InputError(f"expected {FIXED.min_replay_rows} rows with all angles or more, got {len(use)}")
    rows = slice(use[0], use[-1] + 1)
    (found,) = smooth([(time[rows], angle[rows])])
    noise = np.maximum(found.noise, FIXED.min_replay_noise)
    variance = np.einsum("tkii->tik", found.covariance)[:, :2] * (noise / found.noise)[None, None] ** 2
    mean, sd = np.full((2, len(time), 2 * angle.shape[1]), np.nan)
    mean[rows] = found.mean[..., :2].transpose(0, 2, 1).reshape(len(found.time), -1)
    sd[rows] = 3 * np.sqrt(np.maximum(variance, 0.0)).reshape(len(found.time), -1)
    return States(mean, sd, noise)
