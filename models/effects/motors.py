"""What motors make of a command, at one joint or at all joints with equal values: one effect a class.

actuator_deadzone    a motor that small commands do not move: u − clip(u, ±d)
actuator_delay       motors that act late: u(t − T)
actuator_gain        motors whose torque is off by a factor: (1 + ε) u, and servos whose gain is
actuator_lag         motors that follow their command slowly: T u̇_f + u_f = u
actuator_saturation  a motor at its limit: u clipped to ±u_max

A servo makes K c + u₀ − S θ − D θ̇ of its target c, within limits (:mod:`..bodies.joint_parts`). Its gain is the factor
on what it makes of the target and of the quantity that this is for,

τ = (1 + ε)(K c + u₀ − S θ) − D θ̇        if its targets are angles, kp in MuJoCo
τ = (1 + ε)(K c + u₀ − D θ̇) − S θ        if its targets are velocities, kv in MuJoCo
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import ClassVar, Self

import torch
from pyro.distributions import HalfNormal, LogNormal, StudentT
from torch import Tensor

from invdyn.models.bodies.joint_parts import Motor
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Situation, Values, quantiles, with_entry


class Actuator(Effect):
    """Base of effects on a command: ``ActuatorGain("elbow")``, or ``ActuatorGain()`` for all joints together."""

    def __init__(self, *where: str):
        every = not where or (len(where) == 1 and where[0] in self.forms)
        super().__init__(*(("all",) if every else ()), *where)
        self.where = where

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """Every joint, and all of them together where there are several, in every form."""
        joints = [(joint,) for joint in body.joint_names]
        places: list[tuple[str, ...]] = [(), *joints] if len(joints) > 1 else [*joints]
        return [cls(*place, *form) for form in ((), *((word,) for word in cls.forms)) for place in places]

    def of(self, values: list[float]) -> float:
        """Its own joint's of all joints' ``values``, or their mean."""
        return values[self.place[0]] if self.place else sum(values) / len(values)

    def delay_scale(self, scale: Scale) -> float:
        """A long delay for an arm of this speed, s."""
        return 0.2 / self.of(scale.speed)


class OfServos(Effect):
    """Base of the effects that change what the servos at their joints answer, if any are there."""

    servos: Mapping[int, Motor] = MappingProxyType({})
    """Those of its joints, or of all joints where it has no place, by number."""

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        own = {k: parts.servo for k, parts in enumerate(body.joint_parts) if not other.place or k in other.place}
        other.servos = {k: servo for k, servo in own.items() if servo is not None}
        return other


def answer_changed(servo: Motor, k: int, now: Situation, more: Tensor) -> Tensor:
    """Change of what joint ``k``'s ``servo`` gives if it demands so much ``more``, (..., 1) N·m each."""
    if not servo.limited:
        return more
    given = (now.motor if now.commanded is None else now.commanded)[..., k : k + 1]
    whole = given - servo.stiffness * now.q[..., k : k + 1] - servo.damping * now.qd[..., k : k + 1]
    return (whole + more).clamp(servo.low, servo.high) - whole.clamp(servo.low, servo.high)


class ActuatorDeadzone(Effect):
    """Torque 0 for commands within ±d, and smaller by d beyond.

    Small commands distinguish it from a gain.
    """

    order = -4

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Half-width d, N·m."""
        return (Parameter("width", "N·m", HalfNormal(0.06 * scale.effort[self.place[0]])),)

    def command(self, p: Values, command: Command) -> Command:
        """U − clip(u, ±d)."""

        def shrunk(torque: Tensor) -> Tensor:
            u, d = self.own(torque), p["width"]
            return with_entry(torque, self.place[0], u - torch.maximum(torch.minimum(u, d), -d))

        return command.changed(shrunk)


class ActuatorDelay(Actuator):
    """A dead time T between a command and its torque; before the first row the command is the first row's.

    With all joints equal, only a common clock distinguishes it from a late camera.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Dead time T, s."""
        prior = HalfNormal(self.delay_scale(scale))
        return (Parameter("delay", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """u(t − T)."""
        return command.delayed(self.at_joints(p["delay"], command.mean.shape[-1]))

    def late(self, p: Values, elapsed: Tensor) -> Tensor:
        """All of it, until T has passed."""
        return (elapsed < self.at_joints(p["delay"], elapsed.shape[-1])).to(elapsed)


class ActuatorLag(Actuator):
    """A first-order lag between a command and its torque. ``dyntype="filter"`` in MuJoCo.

    Commands above the angular frequency 1/T distinguish it from a delay.
    """

    order = -3

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Time constant T, s."""
        prior = HalfNormal(self.delay_scale(scale))
        return (Parameter("time_constant", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """The lagging torque, at rest with the first command."""
        return command.lagged(self.at_joints(p["time_constant"], command.mean.shape[-1]))

    def late(self, p: Values, elapsed: Tensor) -> Tensor:
        """exp(−t/T)."""
        T = self.at_joints(p["time_constant"], elapsed.shape[-1])
        return torch.exp(-elapsed / T.clamp_min(1e-12)) * (T > 0)


QUANTILES = (0.5, 0.6, 0.7, 0.8, 0.87, 0.93, 0.97)  # of efforts, where a limit is tried


class ActuatorSaturation(Effect):
    """Torque clip(u, ±u_max) at a joint; absent at an infinite u_max. As ``forcerange`` in MuJoCo.

    Commands of several amplitudes distinguish it from a gain.
    """

    order = -2

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Largest torque u_max, N·m; the grid follows the command's own sizes."""
        j = self.place[0]
        sizes = torch.linspace(0, 1, 101) * scale.effort[j] if scale.command is None else scale.command[:, j].abs()
        grid = torch.quantile(sizes, torch.tensor(QUANTILES).to(sizes)).clamp_min(0.02 * scale.effort[j])
        prior = LogNormal(math.log(0.6 * scale.effort[j]), 0.4)
        return (Parameter("limit", "N·m", prior, math.inf, tuple(grid.tolist())),)

    def command(self, p: Values, command: Command) -> Command:
        """clip(u, ±u_max)."""

        def clipped(torque: Tensor) -> Tensor:
            limit = p["limit"]
            return with_entry(torque, self.place[0], torch.maximum(torch.minimum(self.own(torque), limit), -limit))

        return command.changed(clipped)


MIN_GAIN = -0.8
"""Least ε of a motor: arms without mass under motors that give nearly nothing would explain any recording."""
MIN_SERVO_GAIN = -0.999
"""Of a servo, which falls behind its target by what it carries: public files of one arm have gains 56 apart."""
GEARS = 15.0
"""Order of ε for a gear that was left out; robots' gears have ratios from a few to a hundred and sixty."""
LEFT_OUT = 1.0
"""Least ε of such a gear."""


class ActuatorGain(Actuator, OfServos):
    """Torque (1 + ε) u, of a wrong torque constant or gear ratio; of a servo a gain that is not its file's.

    ``ActuatorGain("elbow", "geared")`` is a torque that was logged before its gear. For all joints only a known weight
    or a passive recording distinguishes either from a common factor of all masses. As ``gear`` in MuJoCo.
    """

    order = -1
    forms: ClassVar[tuple[str, ...]] = ("geared",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Excess ε, a pure number; some gears are not what was written down, or were left out."""
        if self.form:
            return (Parameter("gain", "1", HalfNormal(GEARS), least=LEFT_OUT),)
        servos = all(k in self.servos for k in self.place) and bool(self.place)
        return (Parameter("gain", "1", StudentT(3.0, 0.0, 0.15), least=MIN_SERVO_GAIN if servos else MIN_GAIN),)

    def command(self, p: Values, command: Command) -> Command:
        """(1 + ε) u."""
        factor = 1 + self.at_joints(p["gain"], command.mean.shape[-1])
        return command.changed(lambda torque: factor * torque)

    def answer(self, p: Values, now: Situation) -> Tensor | None:
        """−ε S θ, or −ε D θ̇ for targets of velocity, within a servo's limits; the command has the rest."""
        found = [now.at(k, self._more(p["gain"], k, servo, now)) for k, servo in self.servos.items()]
        return sum(found[1:], start=found[0]) if found else None

    def _more(self, gain: Tensor, k: int, servo: Motor, now: Situation) -> Tensor:
        stiff, slow = servo.stiffness * now.q[..., k : k + 1], servo.damping * now.qd[..., k : k + 1]
        return answer_changed(servo, k, now, -gain * (stiff if servo.kind == "position" else slow))
