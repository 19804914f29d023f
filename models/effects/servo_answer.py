"""What servos answer to angle and velocity, changed by an effect: within limits (:mod:`..bodies.joint_parts`)."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Self

from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Situation


class OfServos(Effect):
    """Base of the effects that change what the servos at their joints answer, if any are there."""

    servos: Mapping[int, Motor] = MappingProxyType({})
    """Those of its joints, or of all joints where it has no place, by number."""

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        every = enumerate(body.joint_parts)
        own = {k: parts.servo for k, parts in every if parts is not None and (not other.place or k in other.place)}
        other.servos = {k: servo for k, servo in own.items() if servo is not None}
        return other


def answer_changed(servo: Motor, k: int, now: Situation, more: Tensor) -> Tensor:
    """Change of what joint ``k``'s ``servo`` gives if it demands so much ``more``, (..., 1) N·m each."""
    if not servo.limited:
        return more
    given = (now.motor if now.commanded is None else now.commanded)[..., k : k + 1]
    whole = given - servo.stiffness * now.q[..., k : k + 1] - servo.damping * now.qd[..., k : k + 1]
    return (whole + more).clamp(servo.low, servo.high) - whole.clamp(servo.low, servo.high)
