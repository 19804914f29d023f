"""What a body's file gives its joints besides hinges, as parts of the simulation: :mod:`..bodies.joint_parts`.

Computed by the stages that effects have, so that an effect of the catalogue adds to them: friction of .2 N·m at a joint
whose file says .1 is a change of +.1. They have no place in a search. Their numbers are the model's "body.damping" and
so on, (..., K), which stand as the file has them, or are learned where it calls them uncertain.

A servo's command is the torque that its target alone asks for, K c + u₀ (:func:`servo_torque`), which effects on motors
delay or change as any; its stiffness and damping answer to the angle and the velocity here.

A file may name the engine that simulates it, in steps of first order. What those do to a log is known, and is
simulated only where a recording is taken for that engine's (:meth:`.ArmModel.in_engine_steps`).
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import ABRUPT, Command, Effect, Parameter, Scale, Situation, Values, with_entry


class Filed(Effect):
    """Base: the parts of one joint."""

    def __init__(self, joint: str, number: int, parts: JointParts):
        super().__init__(joint)
        self.place, self.parts = (number,), parts

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """None of its own."""
        return ()


class FiledPassive(Filed):
    """Viscous friction and a spring."""

    def force(self, p: Values, now: Situation) -> Tensor:
        """−b θ̇ − k (θ − θ₀)."""
        j, own = self.place[0], self.parts
        q, qd = self.own(now.q), self.own(now.qd)
        return now.at(j, -self.own(p["damping"]) * qd - self.own(p["stiffness"]) * (q - own.rest))


class FiledRotor(Filed):
    """A rotor's inertia I_a."""

    def inertia(self, p: Values, joints: int) -> Tensor:
        """I_a at the joint."""
        return self.at_joints(p["armature"], joints)


class FiledFriction(Filed):
    """Dry friction of level f."""

    max_substep = ABRUPT
    steady = True

    def friction(self, p: Values, now: Situation) -> Tensor:
        """F."""
        return self.own(p["friction"])


class FiledLimit(Filed):
    """The limits of a motor whose command is a torque."""

    order = -2

    def command(self, p: Values, command: Command) -> Command:
        """clip(u, low, high)."""
        j, motor = self.place[0], self.parts.motor
        assert motor is not None  # a limit is of one
        return command.changed(lambda torque: with_entry(torque, j, self.own(torque).clamp(motor.low, motor.high)))


class FiledServo(Filed):
    """What a servo answers to angle and velocity, −S θ − D θ̇; with its target's torque it keeps to its limits."""

    def answer(self, p: Values, now: Situation) -> Tensor:
        """−S θ − D θ̇, cut where the whole reaches a limit; a torque that no command gives is not the motor's."""
        j, motor = self.place[0], self.parts.servo
        assert motor is not None
        own = -motor.stiffness * self.own(now.q) - motor.damping * self.own(now.qd)
        if motor.limited:
            given = self.own(now.motor if now.commanded is None else now.commanded)
            own = (given + own).clamp(motor.low, motor.high) - given
        return now.at(j, own)


class FiledStep(Filed):
    """First-order steps of h: the command acts h/2 early, dampers as an inertia (:mod:`..bodies.joint_parts`)."""

    def command(self, p: Values, command: Command) -> Command:
        """U(t + h/2)."""
        early = command.mean.new_full((1,), self.parts.step / 2)
        return command.delayed(-self.at_joints(early, command.mean.shape[-1]))

    def inertia(self, p: Values, joints: int) -> Tensor:
        """B h/2 at the joint."""
        inertia = p["armature"].new_full((1,), self.parts.late * self.parts.step / 2)
        return self.at_joints(inertia, joints)


def engine_steps(body: ArticulatedBody) -> tuple[FiledStep, ...]:
    """What steps of the file's own engine do at each joint; none where it takes none of first order."""
    joints = enumerate(zip(body.joint_names, body.joint_parts, strict=True))
    return tuple(FiledStep(joint, k, parts) for k, (joint, parts) in joints if parts.step)


def filed(body: ArticulatedBody, commanded: bool = True) -> tuple[Filed, ...]:
    """The parts that a body's file gives its joints.

    A servo without a command would hold its joint at zero: where torques are unknown, they are all that motors give.
    """
    found: list[Filed] = []
    for number, (joint, parts) in enumerate(zip(body.joint_names, body.joint_parts, strict=True)):
        kinds: list[tuple[type[Filed], object]] = [
            (FiledPassive, parts.damping or parts.stiffness),
            (FiledRotor, parts.armature),
            (FiledFriction, parts.friction),
            (FiledServo, parts.servo is not None and commanded),
            (FiledLimit, parts.motor is not None and parts.servo is None and parts.motor.limited),
        ]
        found += [kind(joint, number, parts) for kind, there in kinds if there]
    return tuple(found)


def answered(body: ArticulatedBody, command: Tensor, q: Tensor, qd: Tensor, limited: bool = True) -> Tensor:
    """Torques (..., K) of all motors under a model's ``command`` in states q, q̇, (..., K); servos answer to them.

    Without their limits where not ``limited``.
    """
    columns = list(command.unbind(-1))
    for k, parts in enumerate(body.joint_parts):
        if (servo := parts.servo) is not None:
            whole = columns[k] - servo.stiffness * q[..., k] - servo.damping * qd[..., k]
            columns[k] = whole.clamp(servo.low, servo.high) if limited else whole
    return torch.stack(columns, -1)


def servo_torque(motor: Motor, target: np.ndarray) -> np.ndarray:
    """K c + u₀, N·m, of targets c in rad or rad/s: what a servo's command is to a model."""
    return motor.gain * target + motor.bias
