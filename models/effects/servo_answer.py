"""What servos answer to angle and velocity, changed by an effect: within limits (:mod:`..bodies.joint_parts`)."""

from collections.abc import Mapping, Sequence

from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.effect_context import Situation


def servos_at(body: ArticulatedBody, place: Sequence[int]) -> Mapping[int, Motor]:
    """Servos at some joints of ``body``, by their numbers; at all of them where ``place`` is empty."""
    every = enumerate(getattr(body, "joint_parts", ()))
    own = {k: parts.servo for k, parts in every if parts is not None and (not place or k in place)}
    return {k: servo for k, servo in own.items() if servo is not None}


def answer_changed(servo: Motor, k: int, now: Situation, more: Tensor) -> Tensor:
    """How much more joint ``k``'s ``servo`` gives where it asks for so much ``more``, (..., 1) N·m each."""
    if not servo.limited:
        return more
    told = (now.motor if now.told is None else now.told)[..., k : k + 1]
    whole = told - servo.stiffness * now.q[..., k : k + 1] - servo.damping * now.qd[..., k : k + 1]
    return (whole + more).clamp(servo.low, servo.high) - whole.clamp(servo.low, servo.high)
