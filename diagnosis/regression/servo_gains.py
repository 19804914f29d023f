"""How far gains of position servos are from their file's, before anything else is fitted.

A servo falls behind its target by the torque that it gives. Public files of one arm have gains that differ by 56 times,
which no expansion about the file's gain describes. So a regression is made about a gain that is estimated first:

    s = K (c − q) = γ τ + Xβ + e,     τ what the file asks for,     X = (q̇, sgn q̇, q̈, 1)

It is a regression of s on τ, and not of τ on s, as all that the file lacks moves s and not τ (instrumental variables).
Where τ says the same as X, as at a hinge that no gravity loads, it is γ that counts: X has a small weight.
A robot's servos are equal: where the log says nothing of one, and most others differ from the file, its γ is their
median. The true gain is K/γ. Within a factor of two of the file's it stays 1, and the regression itself finds the rest.
Rows in which the file's servo would be at its limits either tell nothing, or are like others, as its gain is less. Of
the two, that is taken which leaves less of what the servo then gives, s/γ within its limits.

Shapes: R rows, K joints. Units: rad, s, N·m.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.diagnosis.regression.measured_motion import MeasuredMotion
from invdyn.diagnosis.rules import FIXED


@dataclass(frozen=True)
class ServoGains:
    """Of each joint γ (K,), 1 where nothing is to be changed."""

    factor: np.ndarray

    @property
    def changed(self) -> np.ndarray:
        """(K,) whether a gain is another than the file's."""
        return self.factor != 1.0

    @property
    def far(self) -> "ServoGains":
        """Those that a regression about the file's gain does not take; the others stay the file's."""
        return ServoGains(np.where(np.abs(np.log(self.factor)) > FIXED.linear_servo_gain, self.factor, 1.0))


def servo_gains(motion: MeasuredMotion, required: np.ndarray, body: Any) -> ServoGains:
    """Gains of a body's position servos, from what its file asks of all joints, ``required`` (R, K)."""
    every = body.joint_parts
    factor, unknown = np.ones(len(every)), np.zeros(len(every), bool)
    for k, parts in enumerate(every):
        if (servo := parts.servo) is None or servo.kind != "position":
            continue
        limits, qd, demanded = (servo.low, servo.high), motion.qd[:, k], motion.demanded[:, k]
        X = np.stack([required[:, k], qd, np.sign(qd), motion.qdd[:, k], np.ones(len(qd))], -1)
        given = demanded - motion.servo_drag[:, k]
        rows = [(given > servo.low) & (given < servo.high), np.ones(len(qd), bool)]
        fits = [_regressed(X, demanded, limits, some) for some in rows if some.sum() > 2 * X.shape[1]]
        _, gamma = min(fits, default=(0.0, 1.0))
        unknown[k] = gamma <= 0
        if gamma > 0:
            factor[k] = gamma
    found = ServoGains(factor).far
    if found.changed.sum() > len(every) / 2:
        found.factor[unknown] = np.exp(np.median(np.log(found.factor[found.changed])))
    return found


def _regressed(
    X: np.ndarray, demanded: np.ndarray, limits: tuple[float, float], rows: np.ndarray
) -> tuple[float, float]:
    """Rms N·m that is left of all rows, and γ, by some ``rows``."""
    unit = np.maximum(np.sqrt((X[rows] ** 2).mean(0)), 1e-300)
    unit[1:] *= FIXED.servo_column_weight
    values, *_ = np.linalg.lstsq(X[rows] / unit, demanded[rows], rcond=None)
    fitted = X / unit @ values
    gamma = float(values[0] / unit[0])
    if gamma <= 0:
        return math.inf, gamma
    left = np.clip(demanded / gamma, *limits) - fitted / gamma
    return float(np.sqrt((left**2).mean())), gamma
