"""A motion with the torques along it, and the columns of what these are linear in (:mod:`.torque_fit`).

q̇ and q̈ come from local cubics (Savitzky & Golay 1964) along even rows. The torque passes the same window, so that
both lose the same.

Shapes: R rows, K joints, P unknowns. Units: rad, s, N·m.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from invdyn.diagnosis.check.robot_terms import RobotTerms
from invdyn.diagnosis.regression.measured_motion import hold_mean
from invdyn.diagnosis.regression.regressors import filed_torques, inverse
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.models.dynamics.interface import Dynamics
from invdyn.recordings.logs.mapping import JointMap


@dataclass(frozen=True)
class Motion:
    """A motion (R, K) with what a robot was given along it.

    `smooth` makes of a log's commands (T, K) what its rows have, (R, K). Each row is of a local cubic over so many rows
    as its `span`.
    """

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    terms: RobotTerms
    smooth: Callable[[np.ndarray], np.ndarray] | None = None
    rules: Rules = DEFAULT
    span: float = 1.0

    @property
    def independent(self) -> float:
        """How many independent values its rows have: white noise leaves 9/4W of its variance in cubics over W rows."""
        return len(self.q) * min(1.0, 2.25 / self.span)

    @cached_property
    def torque(self) -> np.ndarray:
        """Of all motors, (R, K)."""
        return self.terms.torque(self.q, self.qd)

    def picked(self, angles: list[int], torques: list[int]) -> "Motion | None":
        """The motion with its columns in other orders; None where a servo's target would be another motor's torque."""
        if (terms := self.terms.commanding(torques)) is None:
            return None
        q, qd, qdd = (terms.angles(each, angles, n == 0) for n, each in enumerate((self.q, self.qd, self.qdd)))
        return replace(self, q=q, qd=qd, qdd=qdd, terms=terms)

    def in_time(self, factor: float) -> "Motion":
        """The motion at times that are multiplied."""
        return replace(self, qd=self.qd / factor, qdd=self.qdd / factor**2)

    def in_unit(self, angle: float = 1.0, target: float = 1.0) -> "Motion":
        """Angles and servos' targets times factors, about the zeros of the log."""
        zero = self.terms.angle.zero
        q, qd, qdd = zero + angle * (self.q - zero), angle * self.qd, angle * self.qdd
        return replace(self, q=q, qd=qd, qdd=qdd, terms=self.terms.retargeted(target))

    def mirrored(self, joints: Sequence[int], angle: bool = False, torque: bool = False) -> "Motion":
        """Angles, commands or both of some joints counted the other way, about the zeros of the log."""
        terms, q, qd, qdd = self.terms, self.q, self.qd, self.qdd
        if angle:
            sign = np.ones(q.shape[1])
            sign[list(joints)] = -1
            q, qd, qdd = terms.angle.zero + sign * (q - terms.angle.zero), sign * qd, sign * qdd
        return replace(self, q=q, qd=qd, qdd=qdd, terms=terms.mirrored(joints) if torque else terms)

    def recounted(self, joint: int, zero: float) -> "Motion":
        """A joint's angle counted from elsewhere: less ``zero`` rad, which a servo's torque does not follow."""
        shift = np.zeros(self.q.shape[1])
        shift[joint] = zero
        return replace(self, q=self.q - shift, terms=self.terms.recounted(shift))

    def commanded(self, factor: np.ndarray | float = 1.0, more: np.ndarray | float = 0.0) -> "Motion":
        """What a model gets as commands times factors (K,), and so much ``more``, N·m."""
        return replace(self, terms=replace(self.terms, commands=factor * self.terms.commands + more))

    def recommanded(self, given: np.ndarray) -> "Motion":
        """The motion under other commands (T, K) than the log's, in the rows in which these are not NaN.

        Raises ValueError of a motion in other rows than its own.
        """
        if self.smooth is None:
            raise ValueError("expected a motion in all of its rows")
        unknown = np.isnan(given)
        made = replace(self, terms=replace(self.terms, commands=self.smooth(np.where(unknown, 0.0, given))))
        return made.at(np.abs(self.smooth(unknown + 0.0)).max(1) < FIXED.negligible) if unknown.any() else made

    def thinned(self, rows: int) -> "Motion":
        """The motion in at most so many ``rows``, evenly."""
        stride = -(-len(self.q) // rows)
        return replace(self.at(slice(None, None, stride)), span=self.span / stride)

    def at(self, every: slice | np.ndarray) -> "Motion":
        """The motion in some of its rows."""
        q, qd, qdd, commands = (each[every] for each in (self.q, self.qd, self.qdd, self.terms.commands))
        return replace(self, q=q, qd=qd, qdd=qdd, terms=replace(self.terms, commands=commands), smooth=None)

    def retargeted(self, factor: np.ndarray) -> "Motion":
        """Servos' targets times factors (K,), about their zeros."""
        return replace(self, terms=self.terms.retargeted(factor))

    def strengthened(self, factor: np.ndarray) -> "Motion":
        """Servos' answers times factors (K,), 1 at other joints."""
        return replace(self, terms=self.terms.strengthened(factor))


def smoothings(
    body: Any,
    time: np.ndarray,
    angle: np.ndarray,
    torque: np.ndarray,
    maps: Sequence[JointMap] | None = None,
    rules: Rules = DEFAULT,
) -> list[Motion]:
    """The motion under each of the windows that it is long enough for; arguments as :func:`smoothed`'s."""
    made = (smoothed(body, time, angle, torque, window, maps, rules) for window in rules.check.cubic_windows)
    return [motion for motion in made if motion is not None]


def passive(body: Any, motion: Motion) -> np.ndarray:
    """What the joints of the file take besides, (R, K): its friction, rotors and springs."""
    return np.stack(filed_torques(body, motion.q, motion.qd, motion.qdd, _sign(motion)), -1)


def _sign(motion: Motion) -> np.ndarray:
    """Of velocities (R, K), tanh(q̇/v): less than 1 where they are small."""
    speed = np.maximum(np.sqrt((motion.qd**2).mean(0)), 1e-12)
    return np.asarray(np.tanh(motion.qd / (motion.rules.check.slow_velocity * speed)))


def smoothed(
    body: Any,
    time: np.ndarray,
    angle: np.ndarray,
    torque: np.ndarray,
    window: int,
    maps: Sequence[JointMap] | None = None,
    rules: Rules = DEFAULT,
) -> Motion | None:
    """Even rows of angles (T, K), NaN where missing, and of torques (T, K) that are constant from each row to the next.

    A servo's torque is what it makes of its target, angle and velocity. ``maps`` are of a robot's own log, which counts
    its joints as the body's own file does. None where there are too few rows for the window.
    """
    use = np.isfinite(angle).all(1)
    if use.sum() < 2 * window:
        return None
    seen = time[use]
    step = float(np.median(np.diff(seen)))
    even = seen[0] + step * np.arange(int((seen[-1] - seen[0]) / step) + 1)
    if len(even) < 2 * window or len(even) > 50 * len(seen):
        return None
    rows = np.stack([np.interp(even, seen, q) for q in angle[use].T], -1)
    stride = max(1, len(even) * max(angle.shape[1], 2) // (2 * rules.check.max_fit_rows))

    def smooth(given: np.ndarray) -> np.ndarray:
        return _local_cubic(hold_mean(time, given, even), window, 0, step, stride)

    q, qd, qdd = (_local_cubic(rows, window, n, step, stride) for n in range(3))
    return Motion(q, qd, qdd, RobotTerms.of(body, smooth(torque), maps), smooth, rules, window / stride)


def _local_cubic(rows: np.ndarray, window: int, order: int, step: float, stride: int) -> np.ndarray:
    """A derivative of the cubic through each ``window`` of even rows (T, K) at its middle, (T − window + 1, K).

    Every ``stride``-th of these.

    :func:`scipy.signal.savgol_filter` at some of the rows, without the ends.
    """
    place = np.arange(window) - window // 2
    weights = np.linalg.pinv(np.vander(place, 4, increasing=True))[order] * math.factorial(order) / step**order
    return np.asarray(np.lib.stride_tricks.sliding_window_view(rows, window, axis=0)[::stride] @ weights)


def as_large(dynamics: Dynamics, body: Any, motion: Motion) -> Motion:
    """The motion with each joint's torques, by no servo, as large as they would have to be."""
    required, given = (
        np.sqrt((each**2).mean(0)) for each in (inverse(dynamics, body.parameters(), motion), motion.torque)
    )
    plain = SimpleNamespace(joint_parts=[NOTHING] * len(given))
    return replace(motion, terms=RobotTerms.of(plain, motion.torque * (required / np.maximum(given, 1e-12)), None))


def joint_regressors(motion: Motion) -> np.ndarray:
    """q̇, tanh(q̇/v) and q̈ of each joint, (3K, R, K)."""
    K = motion.q.shape[1]
    return np.concatenate([np.eye(K)[:, None] * values for values in (motion.qd, _sign(motion), motion.qdd)])
