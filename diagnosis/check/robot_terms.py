"""A motion in the terms of its log: how it counts each joint, and what it commands.

A log's number v becomes an angle, a torque or a target by the joint's line of the mapping and by the robot's own file,

    value = zero + factor · (v − origin),    zero = zero_file + sign_file · zero_map,    factor = sign_file · factor_map

A servo at joint k makes K c + u₀ − S θ − D θ̇ of its target c. Of columns that were exchanged the numbers v were; zeros,
factors and servos stay with their joints. A sign that is wrong turns a value about its zero.

Shapes: R rows, K joints. Units: rad, s, N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch

from invdyn.models.articulated.as_filed import answered, servo_torque
from invdyn.models.bodies.joint_parts import NOTHING, Motor
from invdyn.recordings.logs.mapping import JointMap, Source


@dataclass(frozen=True)
class Counted:
    """How a quantity of each joint is counted, (K,): zeros and ones in a table without a mapping.

    `gear` is the mapping's, and `unit` the ones that it says, None where it says none.
    """

    zero: np.ndarray
    factor: np.ndarray
    origin: np.ndarray
    gear: np.ndarray
    unit: tuple[str | None, ...]

    def raw(self, values: np.ndarray) -> np.ndarray:
        """Numbers (R, K) as the log has them."""
        return (values - self.zero) / self.factor + self.origin

    def of(self, raw: np.ndarray) -> np.ndarray:
        """Values (R, K) of the log's numbers."""
        return self.zero + self.factor * (raw - self.origin)


@dataclass(frozen=True)
class RobotTerms:
    """What a robot commands its motors along a motion, (R, K) N·m as a model gets it, and how its log counts.

    `sign` (K,): whether the robot's own file counts a joint as the body does, 1, or the other way, −1.
    """

    body: Any
    commands: np.ndarray
    sign: np.ndarray
    angle: Counted
    effort: Counted
    target: Counted

    @classmethod
    def of(cls, body: Any, commands: np.ndarray, maps: Sequence[JointMap] | None) -> "RobotTerms":
        """Of ``commands`` (R, K) to a ``body``; ``maps`` of a log that counts joints as the robot's file does."""
        K = commands.shape[1]
        parts = [NOTHING] * K if maps is None else body.joint_parts
        given = list(maps or ()) or [JointMap()] * K
        zero, sign = np.array([own.zero for own in parts]), np.array([own.sign for own in parts])

        def counted(sources: Sequence[Source | None], zero: np.ndarray) -> Counted:
            known = [source or Source("") for source in sources]
            offset = np.array([s.offset + sum(each.offset for each in s.added) for s in known])
            factor = np.array([s.factor or 1.0 for s in known])
            origin, gear = np.array([s.origin for s in known]), np.array([s.gear for s in known])
            return Counted(zero + sign * offset, sign * factor, origin, gear, tuple(s.unit for s in known))

        by_angle = np.array([motor is not None and motor.kind == "position" for motor in servos(body)])
        return cls(
            body,
            commands,
            sign,
            counted([own.angle for own in given], zero),
            counted([own.torque for own in given], np.zeros(K)),
            counted([own.target for own in given], zero * by_angle),
        )

    def torque(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """Of all motors (R, K), with what servos answer to angles and velocities (R, K)."""
        commands, angle, velocity = (torch.as_tensor(each) for each in (self.commands, q, qd))
        return np.asarray(answered(self.body, commands, angle, velocity).numpy())

    def angles(self, values: np.ndarray, order: Sequence[int], zeros: bool = False) -> np.ndarray:
        """Columns (R, K) of angles, with ``zeros``, or of their derivatives, in another order of the log's own."""
        counted, nothing = self.angle, np.zeros_like(self.angle.zero)
        if not zeros:
            counted = replace(counted, zero=nothing, origin=nothing)
        return counted.of(counted.raw(values)[:, list(order)])

    def commanding(self, order: Sequence[int]) -> "RobotTerms | None":
        """The terms with the log's commands in another order; None where one is a target and the other a torque."""
        motors = servos(self.body)
        if any((motors[k] is None) != (motors[j] is None) for k, j in enumerate(order)):
            return None
        targets = np.array([motor is not None for motor in motors])
        own = self._commands()
        raw = np.where(targets, self.target.raw(own), self.effort.raw(own))[:, list(order)]
        return self._commanded(np.where(targets, self.target.of(raw), self.effort.of(raw)))

    def mirrored(self, joints: Sequence[int]) -> "RobotTerms":
        """The terms with the commands of some joints mirrored about their zeros."""
        own = self._commands()
        for k, motor in enumerate(servos(self.body)):
            if k in joints:
                own[:, k] = 2 * (self.effort if motor is None else self.target).zero[k] - own[:, k]
        return self._commanded(own)

    def recounted(self, shift: np.ndarray) -> "RobotTerms":
        """The terms with angles counted from elsewhere, less ``shift`` (K,) rad, and targets so that no torque changes.

        A servo that answers with −S θ then makes that of its target less S times the shift.
        """
        stiffness = np.array([0.0 if motor is None else motor.stiffness for motor in servos(self.body)])
        angle = replace(self.angle, zero=self.angle.zero - shift)
        return replace(self, commands=self.commands - stiffness * shift, angle=angle)

    @property
    def by_target(self) -> tuple[bool, ...]:
        """Whether each joint's log has a servo's target, and no torque."""
        return tuple(motor is not None for motor in servos(self.body))

    @property
    def stated(self) -> dict[str, set[str | None]]:
        """Units that a mapping's lines of angles and of targets say, None where one says none."""
        return {"angle": set(self.angle.unit), "target": set(compress(self.target.unit, self.by_target))}

    @property
    def gears(self) -> np.ndarray:
        """How far the file's own actuator of each servo turns for a radian of its joint, (K,): 1 at other joints."""
        return np.array([1.0 if motor is None else motor.gear for motor in servos(self.body)])

    def retargeted(self, factor: float | np.ndarray) -> "RobotTerms":
        """The terms with servos' targets so many times as large, (K,) or one for all, about their zeros."""
        own, targets = self._commands(), np.array([motor is not None for motor in servos(self.body)])
        return self._commanded(np.where(targets, self.target.zero + factor * (own - self.target.zero), own))

    def strengthened(self, factor: np.ndarray) -> "RobotTerms":
        """The terms of servos that answer so many times as strongly, (K,), within the same limits."""

        def of(motor: Motor, by: float) -> Motor:
            return replace(
                motor,
                gain=by * motor.gain,
                stiffness=by * motor.stiffness,
                damping=by * motor.damping,
                bias=by * motor.bias,
            )

        every = zip(servos(self.body), factor.tolist(), strict=True)
        parts = tuple(NOTHING if motor is None else replace(NOTHING, motor=of(motor, by)) for motor, by in every)
        return replace(self, body=SimpleNamespace(joint_parts=parts), commands=self.commands * factor)

    def _commands(self) -> np.ndarray:
        """Torques, and targets in the body's own counting where there are servos, (R, K)."""
        own = np.array(self.commands)
        for k, motor in enumerate(servos(self.body)):
            if motor is not None:
                own[:, k] = (own[:, k] - motor.bias) / motor.gain
        return own

    def _commanded(self, own: np.ndarray) -> "RobotTerms":
        commands = np.array(own)
        for k, motor in enumerate(servos(self.body)):
            if motor is not None:
                commands[:, k] = servo_torque(motor, own[:, k])
        return replace(self, commands=commands)


def servos(body: Any) -> list[Motor | None]:
    """The servo of each joint, None for those that take torques."""
    return [own.servo for own in body.joint_parts]
