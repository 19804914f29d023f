"""Torques of an arm while it moves: rows in as they come, torques with bands out a stated lag later.

The noise, and the torques' scale and decay, are fitted once, on a recording of the same arm and the same sensors, and
then stand. Torques are an Ornstein–Uhlenbeck process, which is not the default of :func:`invdyn.inference.infer`: with
parameters that are fitted, not drawn, bands of smoother processes are too narrow.

The rows that follow are put on the calibration's grid of times: a row belongs to the step nearest to its time. Steps
without a row are taken as missing, a second row of a step fills in what the first one
lacks, and a row later than the window is counted and left out (:class:`.online.fixed_lag_smoother.Counts`).

A row is what a recording of this project has in a line: ``<keypoint>_x`` …, ``<joint>_angle`` and, where the
calibration has commands, ``<joint>_torque``, in SI units. What is absent or not finite is missing; a command stands
until the next one comes. Torques are the model's, of which the band holds 90 % (5 % to 95 % of a Gaussian).
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.online.change import ChangeTest
from invdyn.inference.online.fixed_lag_smoother import WINDOW, FixedLagSmoother, Smoothed
from invdyn.inference.posterior.functionals import Z90
from invdyn.inference.task import prepare
from invdyn.models import ArmModel, ArticulatedBody, OrnsteinUhlenbeck
from invdyn.models.bodies.protocol import axes
from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras import Filmed

MAX_GAP = 10.0
"""s by which time jumps, either way, after which all begins again: what was before says no more of the motion."""
LAST_TIME = 1e11
"""s: beyond, times are in another unit, or nonsense."""


@dataclass(frozen=True)
class LiveRow:
    """One row's answer.

    Attributes:
        time: s, of the grid's step.
        torque, angle, velocity: mean and standard deviation, (2, K): N·m, rad, rad/s.
        changed: whether the rows up to here say that the body is no more the one of the calibration.
    """

    time: float
    torque: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    changed: bool


class LiveArm:
    """An arm's torques as rows come.

    Args:
        calibration: a recording of the same arm, sensors and frame rate, some hundred rows or more.
        body: the arm.
        lag: s.
        fps: rows/s; by default the calibration's.
        settings: parameters by dotted name that are known, as of :func:`invdyn.inference.infer`.
        hide_torque: ignore commands.
        hours: per false alarm of a change, at least, in the mean.

    Raises InputError as :func:`invdyn.inference.infer` does, and for a lag or a rate that cannot be.
    """

    def __init__(
        self,
        calibration: Recording,
        body: ArticulatedBody,
        *,
        lag: float = 0.05,
        fps: float | None = None,
        settings: Mapping[str, object] | None = None,
        hide_torque: bool = False,
        hours: float = 2.0,
        report: Callable[[int, int], None] | None = None,
    ):
        if isinstance(calibration, Filmed):
            raise InputError("expected a table of keypoints or encoders as the calibration, got a film of cameras")
        self.fps = float(fps or 1 / calibration.frame_interval)
        if not (0 <= lag <= 5 and self.fps > 0):
            raise InputError(f"expected a lag from 0 to 5 s and a positive frame rate, got {lag:g} s and {fps}")
        rows = round(lag * self.fps)
        task = prepare(
            calibration,
            body,
            options=SMCOptions(),
            seed=0,
            settings=settings,
            hide_torque=hide_torque,
            moving_base=False,
            report=report,
            torque=OrnsteinUhlenbeck(),
        )
        model = task.problem.model
        self.body, commanded = model.body, model.command is not None
        tracked = [name for name in calibration.keypoint_names if name in self.body.keypoint_names]
        self.columns = [f"{name}_{axis}" for name in tracked for axis in axes(self.body)]
        joints = self.body.joint_names
        if model.observation_dim > len(self.columns):
            self.columns += [f"{name}_angle" for name in joints]
        self.commands = [f"{name}_torque" for name in joints] if commanded else []
        grid = np.arange(max(rows + 1, WINDOW) + 2) / self.fps
        self.smoother = FixedLagSmoother(
            model.at_times(grid),
            rows,
            with_inputs=(lambda own, inputs: own.commanded(inputs)) if commanded else None,
            at_start=about_pose,
        )
        self.test = ChangeTest(self.fps, hours)
        self.forget()

    def forget(self) -> None:
        """Forget all rows; what was fitted stays."""
        self.smoother.forget()
        self.test.restart()
        self._first: float | None = None
        self._command = np.full(len(self.commands), np.nan)
        self._restarts = 0

    def add(self, time: float, values: Mapping[str, float]) -> list[LiveRow]:
        """Take the row of ``time``, s, and return the answers that are due.

        Raises InputError for a time that is no number of seconds, for a row none of whose names is known, and for one
        without a command before the first that has it. Such a row changes nothing, and the next one may come.
        """
        if not abs(time) < LAST_TIME:
            raise InputError(f"expected the time of a row in seconds, got {time}")
        if not values.keys() & {*self.columns, *self.commands}:
            raise InputError(f"expected a row with columns among {', '.join(self.columns)}, got {', '.join(values)}")
        y, own = (_finite(values, names) for names in (self.columns, self.commands))
        command = np.where(np.isnan(own), self._command, own)
        if missing := [name for name, value in zip(self.commands, command, strict=True) if math.isnan(value)]:
            raise InputError(
                f"expected {', '.join(missing)} from the first row on, as the calibration has commands, got none: "
                "send it, or hide the commands (--set hide_torque=yes)"
            )
        self._first = time if self._first is None else self._first
        step = round((time - self._first) * self.fps)
        found: list[Smoothed] = []
        if abs(step - self.smoother.next) > MAX_GAP * self.fps:
            found += self.smoother.restart(step)
        late = step < self.smoother.next
        self._command = self._command if late else command  # what comes late does not stand
        inputs = None if not self.commands or (late and np.isnan(own).any()) else command
        return [self._answer(each) for each in found + self.smoother.add(step, y, inputs)]

    def finish(self) -> list[LiveRow]:
        """Answers of the last rows: none is to come."""
        return [self._answer(each) for each in self.smoother.finish()]

    def table_row(self, row: LiveRow) -> dict[str, float]:
        """An answer as a line of a table: as the curves of `invdyn infer` have it, median and ends of the bands."""
        line = {"time": row.time}
        for quantity in ("torque", "angle", "velocity"):
            mean, sd = getattr(row, quantity)
            for k, joint in enumerate(self.body.joint_names):
                for suffix, side in (("", 0.0), ("_q05", -Z90), ("_q95", Z90)):
                    line[f"{joint}_{quantity}{suffix}"] = float(mean[k] + side * sd[k])
        return line | {"changed": float(row.changed)}

    def follow(self, rows: Iterable[tuple[float, Mapping[str, float]]]) -> Iterator[LiveRow]:
        """Answers of rows (time, values) as these come."""
        for time, values in rows:
            yield from self.add(time, values)
        yield from self.finish()

    def _answer(self, state: Smoothed) -> LiveRow:
        if self.smoother.counts.restarts > self._restarts:
            self._restarts = self.smoother.counts.restarts
            self.test.restart()
        if changed := self.test.add(state.innovation):
            self.test.restart()
        joints = self.body.num_joints
        both = np.stack([state.mean, state.sd])
        torque = both[:, :joints].copy()  # the rest is other states, then angles and velocities
        if state.inputs is not None:
            torque[0] += state.inputs
        assert self._first is not None
        time = self._first + state.t / self.fps
        return LiveRow(time, torque, both[:, -2 * joints : -joints], both[:, -joints:], changed)


def _finite(values: Mapping[str, float], names: list[str]) -> np.ndarray:
    """Values of some names, NaN where they are absent or no finite numbers."""
    found = np.array([values.get(name, math.nan) for name in names], dtype=float)
    return np.where(np.isfinite(found), found, np.nan)


def about_pose(model: ArmModel, rows: Tensor) -> ArmModel:
    """The model whose prior is about the pose that the first of some rows (T, O) shows."""
    paths = model.initial_paths(rows)
    return model.replace(**{"initial.angle": model.split(paths[len(paths) // 2])[1][0]})
