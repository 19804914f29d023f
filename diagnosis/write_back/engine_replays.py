"""Windows of a robot's logs, replayed by MuJoCo from smoothed states with many models at once.

A model steps on an even grid as fine as its file's; a command holds from its row to the next, and angles are read
between steps at the rows' times, so that an uneven clock does no harm. Each step's solver starts from the same state
in every run, so that the same models give the same bits on any number of threads.

Shapes: B models, R rows of a window, S steps, K joints, N numbers (:mod:`.file_numbers`). Units: rad, s.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.file_numbers import FileNumbers
from invdyn.diagnosis.write_back.rollout import commands, smoothed_states
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts_mjcf import joint_names, kept_warnings
from invdyn.recordings import Recording

GIVEN = int(mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_QFRC_APPLIED)
STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)


@dataclass(frozen=True)
class Window:
    """What a replay needs, and is compared with.

    Attributes:
        state: (2K,) the first angles and velocities, as the file counts them.
        given: (S, G) controls and applied torques in each step of the engine.
        step: s.
        times: (R,) of the rows, s from the first state on.
        angle: (R, K) at these.
    """

    state: np.ndarray
    given: np.ndarray
    step: float
    times: np.ndarray
    angle: np.ndarray


def seconds(body: ArticulatedBody) -> float:
    """How long a window is: servos hold an arm near its path; without them it runs from it."""
    driven = [parts for parts in body.joint_parts if parts.motor is not None]
    return FIXED.refine_window if all(each.servo is not None for each in driven) else FIXED.replay_window


def windows(numbers: FileNumbers, recording: Recording) -> list[Window]:
    """Windows of a recording from end to end, in which no row lacks an angle or command and time does not jump.

    None of a recording without encoders of all joints.
    """
    model, body = numbers.nominal, numbers.body
    if recording.angles is None or set(body.joint_names) - set(recording.joint_names):
        return []
    order = [recording.joint_names.index(name) for name in body.joint_names]
    sign, zero = body.file_counting
    angle = sign * (recording.angles[:, order] - zero)
    if np.isfinite(angle).all(1).sum() < FIXED.min_replay_rows:
        return []
    time, states, what = recording.time, smoothed_states(recording.time, angle), commands(model, body, recording)
    given = np.concatenate([what.control, what.applied], 1)
    row_step = float(np.median(np.diff(time)))
    step = row_step / max(1, int(np.ceil(row_step / model.opt.timestep - 1e-6)))
    length, found = max(2, round(seconds(body) / row_step)), []
    for first in range(0, len(time) - length, length):
        rows = slice(first + 1, first + length + 1)
        start, times = states.mean[first], time[rows] - time[first]
        jumps = np.diff(time[first : first + length + 1]).max() > FIXED.max_gap_steps * row_step
        if jumps or not np.isfinite(start).all():
            continue
        at = time[first] + step * np.arange(int(np.ceil(times[-1] / step - 1e-6)))
        row = np.searchsorted(time, at + 1e-6 * step, side="right") - 1
        if np.isfinite(given[row]).all() and np.isfinite(angle[rows]).all():
            found.append(Window(start, given[row], step, times, angle[rows]))
    return found


class Replays:
    """Replays of windows by MuJoCo, with numbers that differ."""

    def __init__(self, numbers: FileNumbers, workers: int = 1):
        self.numbers = numbers
        model, body = numbers.nominal, numbers.body
        hinges = [joint_names(model).index(joint) for joint in body.joint_names]
        self.at, self.of = model.jnt_qposadr[hinges], model.jnt_dofadr[hinges]
        self.data = [mujoco.MjData(model) for _ in range(workers)]

    def errors(self, z: np.ndarray, window: Window) -> np.ndarray:
        """What models with numbers (B, N) are off by, as :meth:`off`."""
        return self.off([self.numbers.model(each) for each in z], window)

    def off(self, models: list["mujoco.MjModel"], window: Window) -> np.ndarray:
        """What models are off by (B, R, K), rad, up to `replay_runs_away`; their time step is changed."""
        first = mujoco.MjData(models[0])
        first.qpos[self.at], first.qvel[self.of] = np.split(window.state, 2)
        start = np.empty(mujoco.mj_stateSize(models[0], STATE))
        mujoco.mj_getState(models[0], first, start, STATE)
        for model in models:
            model.opt.timestep = window.step
        with kept_warnings(mujoco):
            state, _ = rollout.rollout(
                models,
                self.data,
                np.repeat(start[None], len(models), 0),
                np.repeat(window.given[None], len(models), 0),
                control_spec=GIVEN,
            )
        angle = np.concatenate([np.repeat(start[None, None], len(models), 0), state], 1)[..., 1 + self.at]
        place = window.times / window.step
        row = np.minimum(place.astype(int), angle.shape[1] - 2)
        part = (place - row)[:, None]
        off = (1 - part) * angle[:, row] + part * angle[:, row + 1] - window.angle
        worst = FIXED.replay_runs_away
        off = np.nan_to_num(off, nan=worst, posinf=worst, neginf=-worst)
        return np.clip(off, -worst, worst)
