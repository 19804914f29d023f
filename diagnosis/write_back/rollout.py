"""A file's own simulation against a log: MuJoCo loads it, replays the commands, and what it is off by is counted.

The engine is set to the recorded state every `replay_window` seconds and left to run between. States are local cubics
of the recorded angles, which know of no simulation; cross-validation says how long.
A file that says a joint has a delay keeps its past across a window.

Shapes: T rows, K joints.
"""

from dataclasses import dataclass
from functools import partial
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
    """What a file's simulation is off by, rms: each joint's angle, rad, by name; in so many windows."""

    angle_rms: dict[str, float]
    windows: int

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
    try:
        model = mujoco.MjModel.from_xml_path(path)
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from error
    data = mujoco.MjData(model)
    own = [parts or NOTHING for parts in body.joint_parts]
    signs, zeros = np.array([parts.sign for parts in own]), np.array([parts.zero for parts in own])
    hinges = [joint_names(model).index(joint) for joint in body.joint_names]
    at, of = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
    q, qd = states(time, signs * (angle - zeros))
    step = float(np.median(np.diff(time)))
    parts = max(1, int(np.ceil(step / model.opt.timestep - 1e-6)))
    every = max(2, round(FIXED.replay_window / step))
    off = np.full((len(time), len(hinges)), np.nan)
    windows, running = 0, False
    for row in range(len(time) - 1):
        if not running or row % every == 0:
            if not np.isfinite(q[row]).all():
                running = False
                continue
            data.qpos[at], data.qvel[of] = q[row], qd[row]
            windows, running = windows + 1, True
        data.ctrl[:], data.qfrc_applied[:] = given.control[row], given.applied[row]
        model.opt.timestep = (time[row + 1] - time[row]) / parts
        with kept_warnings(mujoco):  # a simulation that is thrown off shows in the error
            mujoco.mj_step(model, data, parts)
        off[row + 1] = data.qpos[at] - signs * (angle[row + 1] - zeros)
    seen = np.isfinite(off)
    if seen.sum() < len(hinges):
        raise InputError(f"{path}: too few rows with angles to replay the log in it")
    rms = [float(np.sqrt((each[ok] ** 2).mean())) for each, ok in zip(off.T, seen.T, strict=True)]
    return Rollout(dict(zip(body.joint_names, rms, strict=True)), windows)


def states(time: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed angles and velocities (T, K) at each row, NaN before the first and after the last that has angles.

    A joint's local cubic spans as many rows as predict a row that is left out best.
    """
    use = np.isfinite(angle).all(1)
    if use.sum() < FIXED.min_replay_rows:
        raise InputError(f"expected {FIXED.min_replay_rows} rows with all angles or more, got {use.sum()}")
    seen = time[use]
    step = float(np.median(np.diff(seen)))
    even = seen[0] + step * np.arange(int((seen[-1] - seen[0]) / step + 1e-6) + 1)
    found: list[list[np.ndarray]] = [[], []]
    for joint in angle[use].T:
        rows = np.interp(even, seen, joint)
        span = min((span for span in FIXED.cubic_spans if span <= len(even)), key=partial(_left_out, rows))
        for order, columns in enumerate(found):
            smooth = savgol_filter(rows, span, 3, deriv=order, delta=step)
            columns.append(np.interp(time, even, smooth, np.nan, np.nan))
    q, qd = (np.stack(columns, -1) for columns in found)
    return q, qd


def _left_out(rows: np.ndarray, span: int) -> float:
    """Mean square of what a local cubic over ``span`` rows, without a row (T,), is off by there."""
    own = savgol_coeffs(span, 3)[span // 2]
    inner = slice(span // 2, len(rows) - span // 2)
    return float((((rows - savgol_filter(rows, span, 3)) / (1 - own))[inner] ** 2).mean())
