"""A motion with the torques along it, and the columns of what these are linear in (:mod:`.torque_fit`).

q̇ and q̈ come from local cubics (Savitzky & Golay 1964) along even rows. The torque passes the same window, so that
both lose the same.

Shapes: R rows, K joints, P unknowns. Units: rad, s, N·m.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invdyn.diagnosis.check.robot_terms import RobotTerms
from invdyn.diagnosis.regression.regressors import filed_torques, inverse
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.models.dynamics.interface import Dynamics
from invdyn.recordings.logs.mapping import JointMap


@dataclass(frozen=True)
class Motion:
    """A motion and the torques given along it, each (R, K); `terms` are the robot's, None where they are unknown.

    `smooth` makes of a log's commands (T, K) what its rows have, (R, K).
    """

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    torque: np.ndarray
    terms: RobotTerms | None = None
    smooth: Callable[[np.ndarray], np.ndarray] | None = None
    rules: Rules = DEFAULT

    def picked(self, angles: list[int], torques: list[int]) -> "Motion | None":
        """The motion with its columns in other orders; None where a servo's target would be another motor's torque."""
        if self.terms is None:
            q, qd, qdd = (each[:, angles] for each in (self.q, self.qd, self.qdd))
            return replace(self, q=q, qd=qd, qdd=qdd, torque=self.torque[:, torques])
        if (terms := self.terms.commanding(torques)) is None:
            return None
        q, qd, qdd = (terms.angles(each, angles, n == 0) for n, each in enumerate((self.q, self.qd, self.qdd)))
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def scaled(self, angle: Any = 1.0, torque: Any = 1.0, time: float = 1.0) -> "Motion":
        """Angles, torques (numbers or (K,)) and times multiplied; the robot's terms are dropped."""
        q, qd, qdd = self.q * angle, self.qd * angle / time, self.qdd * angle / time**2
        return Motion(q, qd, qdd, self.torque * torque, rules=self.rules)

    def in_unit(self, angle: float = 1.0, target: float = 1.0) -> "Motion | None":
        """Angles and servos' targets times factors, about the zeros of the log; None where no target is known."""
        if self.terms is None:
            return self.scaled(angle=angle) if target == 1 else None
        terms, zero = self.terms.retargeted(target), self.terms.angle.zero
        q, qd, qdd = zero + angle * (self.q - zero), angle * self.qd, angle * self.qdd
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def mirrored(self, joints: Sequence[int], angle: bool = False, torque: bool = False) -> "Motion":
        """Angles, commands or both of some joints counted the other way, about the zeros of the log."""
        sign = np.ones(self.q.shape[1])
        sign[list(joints)] = -1
        if self.terms is None:
            return self.scaled(angle=sign if angle else 1.0, torque=sign if torque else 1.0)
        terms, q, qd, qdd = self.terms, self.q, self.qd, self.qdd
        if angle:
            q, qd, qdd = terms.angle.zero + sign * (q - terms.angle.zero), sign * qd, sign * qdd
        if torque:
            terms = terms.mirrored(joints)
        return replace(self, q=q, qd=qd, qdd=qdd, torque=terms.torque(q, qd), terms=terms)

    def recounted(self, joint: int, zero: float) -> "Motion":
        """A joint's angle counted from elsewhere: less ``zero`` rad, which a servo's torque does not follow."""
        shift = np.zeros(self.q.shape[1])
        shift[joint] = zero
        return replace(self, q=self.q - shift, terms=None if self.terms is None else self.terms.recounted(shift))

    def recommanded(self, given: np.ndarray) -> "Motion":
        """The motion under other commands (T, K) than the log's, in the rows in which these are not NaN.

        Raises ValueError of a motion in other rows than its own.
        """
        if self.smooth is None:
            raise ValueError("expected a motion in all of its rows")
        unknown = np.isnan(given)
        commands, terms = self.smooth(np.where(unknown, 0.0, given)), self.terms
        if terms is not None:
            terms = replace(terms, commands=commands)
            commands = terms.torque(self.q, self.qd)
        made = replace(self, torque=commands, terms=terms)
        return made.at(np.abs(self.smooth(unknown + 0.0)).max(1) < FIXED.negligible) if unknown.any() else made

    def thinned(self, rows: int) -> "Motion":
        """The motion in at most so many ``rows``, evenly."""
        return self.at(slice(None, None, -(-len(self.q) // rows)))

    def at(self, every: slice | np.ndarray) -> "Motion":
        """The motion in some of its rows."""
        q, qd, qdd, torque = (each[every] for each in (self.q, self.qd, self.qdd, self.torque))
        terms = None if self.terms is None else replace(self.terms, commands=self.terms.commands[every])
        return replace(self, q=q, qd=qd, qdd=qdd, torque=torque, terms=terms, smooth=None)

    def retargeted(self, factor: np.ndarray) -> "Motion | None":
        """Servos' targets times factors (K,), about their zeros; None where no target is known."""
        if self.terms is None:
            return None
        terms = self.terms.retargeted(factor)
        return replace(self, torque=terms.torque(self.q, self.qd), terms=terms)

    def strengthened(self, factor: np.ndarray) -> "Motion | None":
        """Servos' answers times factors (K,), 1 at other joints; None where no servo is known."""
        if self.terms is None:
            return None
        terms = self.terms.strengthened(factor)
        return replace(self, torque=terms.torque(self.q, self.qd), terms=terms)


def smoothings(
    body: Any,
    time: np.ndarray,
    angle: np.ndarray,
    torque: np.ndarray,
    maps: Sequence[JointMap] | None = None,
    rules: Rules = DEFAULT,
) -> list[Motion]:
    """The motion under each of the windows that it is long enough for; arguments as :func:`smoothed`'s.

    A servo's torque is what it makes of its target, angle and velocity. ``maps`` are of a robot's own log, which counts
    its joints as the body's own file does.
    """
    made = (smoothed(time, angle, torque, window, rules) for window in rules.check.cubic_windows)
    return [_by_servos(motion, RobotTerms.of(body, motion.torque, maps)) for motion in made if motion is not None]


def _by_servos(motion: Motion, terms: RobotTerms) -> Motion:
    return replace(motion, torque=terms.torque(motion.q, motion.qd), terms=terms)


def passive(body: Any, motion: Motion) -> np.ndarray:
    """What the joints of the file take besides, (R, K): its friction, rotors and springs."""
    speed = np.maximum(np.sqrt((motion.qd**2).mean(0)), 1e-12)
    sign = np.tanh(motion.qd / (motion.rules.check.slow_velocity * speed))
    return np.stack(filed_torques(body, motion.q, motion.qd, motion.qdd, sign), -1)


def smoothed(
    time: np.ndarray, angle: np.ndarray, torque: np.ndarray, window: int, rules: Rules = DEFAULT
) -> Motion | None:
    """Even rows of angles (T, K), NaN where missing, and of torques (T, K) that are constant from each row to the next.

    None where there are too few rows for the window.
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
    width = np.minimum(even + step / 2, time[-1]) - np.maximum(even - step / 2, time[0])

    def smooth(given: np.ndarray) -> np.ndarray:
        # constant: over half a row before and after each even one, on average
        total = np.concatenate([np.zeros((1, given.shape[1])), np.cumsum(given[:-1] * np.diff(time)[:, None], 0)])
        area = [np.stack([np.interp(even + way * step / 2, time, each) for each in total.T], -1) for way in (-1, 1)]
        return _local_cubic((area[1] - area[0]) / width[:, None], window, 0, step, stride)

    q, qd, qdd = (_local_cubic(rows, window, n, step, stride) for n in range(3))
    return Motion(q, qd, qdd, smooth(torque), smooth=smooth, rules=rules)


def _local_cubic(rows: np.ndarray, window: int, order: int, step: float, stride: int) -> np.ndarray:
    """A derivative of the cubic through each ``window`` of even rows (T, K) at its middle, (T − window + 1, K).

    Every ``stride``-th of these.

    :func:`scipy.signal.savgol_filter` at some of the rows, without the ends.
    """
    place = np.arange(window) - window // 2
    weights = np.linalg.pinv(np.vander(place, 4, increasing=True))[order] * math.factorial(order) / step**order
    return np.asarray(np.lib.stride_tricks.sliding_window_view(rows, window, axis=0)[::stride] @ weights)


def as_large(dynamics: Dynamics, body: Any, motion: Motion) -> Motion:
    """The motion with each joint's torques as large as they would have to be."""
    required, given = (
        np.sqrt((each**2).mean(0)) for each in (inverse(dynamics, body.parameters(), motion), motion.torque)
    )
    return motion.scaled(torque=required / np.maximum(given, 1e-12))


def joint_regressors(motion: Motion) -> np.ndarray:
    """q̇, tanh(q̇/v) and q̈ of each joint, (3K, R, K)."""
    K = motion.q.shape[1]
    speed = np.maximum(np.sqrt((motion.qd**2).mean(0)), 1e-12)
    each = (motion.qd, np.tanh(motion.qd / (motion.rules.check.slow_velocity * speed)), motion.qdd)
    return np.concatenate([np.eye(K)[:, None] * values for values in each])
