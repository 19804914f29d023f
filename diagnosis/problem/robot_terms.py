"""A motion in the terms of the robot that wrote it: how it counts its joints, and what it told its motors.

A log's angles are θ = zero + sign · q and its torques sign · u. A servo at joint k makes K c + u₀ − S θ − D θ̇ of its
target c. Columns that were exchanged were so in q, u and c: each joint's zero, sign and servo stay where they are.

Shapes: R rows, K joints. Units: rad, s, N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from invdyn.models.articulated.as_filed import answered, servo_torque
from invdyn.models.bodies.joint_parts import NOTHING, Motor


@dataclass(frozen=True)
class RobotTerms:
    """What a robot told its motors along a motion, (R, K) N·m as a model is told it, and how it counts its joints.

    `zero` and `sign` (K,) are 0 and 1 where angles are the body's own, as in a table without a mapping.
    """

    body: Any
    told: np.ndarray
    zero: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, body: Any, told: np.ndarray, counted: bool) -> "RobotTerms":
        """Of commands ``told`` (R, K) to a ``body``, whose own file counts the joints if ``counted``."""
        parts = [own or NOTHING for own in getattr(body, "joint_parts", ())] if counted else []
        parts = parts or [NOTHING] * told.shape[1]
        return cls(body, told, np.array([own.zero for own in parts]), np.array([own.sign for own in parts]))

    def torque(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Of all motors (R, K), with what servos answer to angles and velocities (R, K)."""
        told, angle, velocity = (torch.as_tensor(each) for each in (self.told, q, qd))
        return np.asarray(answered(self.body, told, angle, velocity).numpy())

    def angles(self, values: np.ndarray, order: Sequence[int], zeros: bool = False) -> np.ndarray:
        """Columns (R, K) of angles, with ``zeros``, or of their derivatives, in another order of the robot's own."""
        zero = self.zero if zeros else np.zeros_like(self.zero)
        return zero + self.sign * (self.sign * (values - zero))[:, list(order)]

    def commanding(self, order: Sequence[int]) -> "RobotTerms | None":
        """The terms with the motors' commands in another order; None where one is a target and the other a torque."""
        motors = servos(self.body, self.told.shape[1])
        if any((motors[k] is None) != (motors[j] is None) for k, j in enumerate(order)):
            return None
        own = self.sign * self.told
        for k, motor in enumerate(motors):
            if motor is not None:
                own[:, k] = self.sign[k] * ((self.told[:, k] - motor.bias) / motor.gain - self._at(k, motor))
        told = self.sign * own[:, list(order)]
        for k, motor in enumerate(motors):
            if motor is not None:
                told[:, k] = servo_torque(motor, told[:, k] + self._at(k, motor))
        return RobotTerms(self.body, told, self.zero, self.sign)

    def _at(self, k: int, motor: Motor) -> float:
        """The robot's zero of a target, in the body's own counting."""
        return float(self.zero[k]) if motor.kind == "position" else 0.0


def servos(body: Any, joints: int) -> list[Motor | None]:
    """The servo of each joint, None for those that are told torques."""
    parts = getattr(body, "joint_parts", ()) or [None] * joints
    return [None if own is None else own.servo for own in parts]
