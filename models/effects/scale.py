"""A parameter of an effect, and what is large and what is small for a body: the scales that its prior follows.

A parameter has a name, a unit, a prior, and the value at which the effect is absent. A mouse limb and an industrial arm
have the same catalogue; only the scales differ. Per joint, with what is beyond it stretched out:

    inertia   Σ I + m r² about the joint                            kg·m²
    torque    the gravity load of the level arm; without gravity, what moves it by a radian in a fifth of a second   N·m
    speed     √(torque / inertia), of a swing under that torque, or what has been seen if slower     rad/s
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from pyro.distributions import Distribution, HalfNormal, Normal
from torch import Tensor

from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.dynamics.interface import Dynamics

Values = Mapping[str, Tensor]
"""An effect's own parameters by their own names, (..., 1) each."""

GUESSED = 0.5
"""Relative error, a standard deviation, of friction or a rotor that a file states: more are guessed than measured."""


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    Attributes:
        name: a plain word.
        unit: such as "N·m·s/rad"; "1" for a pure number.
        prior: scalar Pyro distribution; its width follows from the body's scales.
        absent: value at which the effect vanishes, for any values of the others; None for a parameter that has none,
            such as a frequency.
        grid: values at which a screen evaluates a parameter in which the effect is not linear from ``absent`` on,
            distributed as the prior is.
        least: no smaller value is plausible, though the prior has a tail there.
    """

    name: str
    unit: str
    prior: Distribution
    absent: float | None = 0.0
    grid: tuple[float, ...] = ()
    least: float = -math.inf

    @property
    def located(self) -> bool:
        """Whether the recording itself suggests its values: of an effect that acts for a while its ``moment``, the
        middle, and its ``duration``, s.
        """
        return self.absent is None and not self.grid


def quantiles(prior: Distribution, count: int) -> tuple[float, ...]:
    """Middles of ``count`` intervals of equal prior probability."""
    return tuple(prior.icdf((torch.arange(count) + 0.5) / count).tolist())


def change(name: str, unit: str, sd: float, filed: float, shares: Sequence[float] = ()) -> Parameter:
    """A parameter of 0 or more, half-normal of ``sd``; where the simulation's file has ``filed`` of it, a change.

    ``shares`` of the prior's width are where a screen looks, if the effect is not linear in it.
    """
    if filed <= 0:
        return Parameter(name, unit, HalfNormal(sd), 0.0, tuple(sd * x for x in shares))
    wide = math.hypot(sd, GUESSED * filed)
    lower = [-x * filed for x in (0.9, 0.5)] if shares else []
    return Parameter(name, unit, Normal(0.0, wide), 0.0, (*lower, *(wide * x for x in shares)), least=-filed)


NEGLIGIBLE = 1e-9
"""Of the typical torque: a smaller command is none, and rounds to 0 in float32."""


def typical_torque(dynamics: Dynamics, body: Any) -> Tensor:
    """Torques (K,) that a body needs, N·m; see the top of the file."""
    return torch.maximum(dynamics.typical_load(body), 5.0 * dynamics.typical_inertia(body))


@dataclass(frozen=True, eq=False)
class Experience:
    """What has been seen of a body's motion.

    Attributes:
        motion: (K,) rad/s, rms velocity of each joint, or None.
        range: (K, 2) rad, between which each joint turns, or None.
    """

    motion: Tensor | None = None
    range: Tensor | None = None


@dataclass(frozen=True)
class Scale:
    """Scales of a body on a time grid.

    Attributes:
        dynamics: of the body.
        body: its nominal numbers, single (no batch dimensions).
        time: (T,) s.
        command: (T, K) N·m, or None.
        motion: (K,) rad/s, rms velocity of each joint where it has been seen, or None.
        range: (K, 2) rad, between which each joint has been seen to turn, or None.
        parts: what the simulation's own joints have.
    """

    dynamics: Dynamics
    body: Any
    time: Tensor
    command: Tensor | None = None
    motion: Tensor | None = None
    range: Tensor | None = None
    parts: Sequence[JointParts] = ()

    def filed(self, quantity: str, joint: int) -> float:
        """What the simulation's own joint has of a quantity such as "damping"; 0 for nothing."""
        return float(getattr(self.parts[joint], quantity)) if joint < len(self.parts) else 0.0

    def servo_damping(self, joint: int) -> float:
        """How much a servo of the simulation's own joint damps it, N·m·s/rad."""
        return self.parts[joint].servo_damping if joint < len(self.parts) else 0.0

    @cached_property
    def torque(self) -> list[float]:
        """Per joint, N·m; a body that no gravity loads has the size of its commands to go by, where there are any."""
        torque = typical_torque(self.dynamics, self.body)
        if self.command is not None and not bool(self.body.gravity.any()):
            given = 2 * self.command.square().mean(0).sqrt().to(torque)
            torque = torch.where(given > NEGLIGIBLE * torque, given, torque)
        return torque.tolist()

    @cached_property
    def inertia(self) -> list[float]:
        """Per joint, kg·m²."""
        return self.dynamics.typical_inertia(self.body).tolist()

    @cached_property
    def speed(self) -> list[float]:
        """Per joint, rad/s: of a swing under the typical torque, or as seen, if that is slower."""
        swing = [(t / i) ** 0.5 for t, i in zip(self.torque, self.inertia, strict=True)]
        if self.motion is None:
            return swing
        return [min(max(seen, 0.02 * own), own) for seen, own in zip(self.motion.tolist(), swing, strict=True)]

    @cached_property
    def reach(self) -> float:
        """How far it reaches, m: of a chain the sum of the links' lengths."""
        return self.dynamics.reach(self.body).item()

    @cached_property
    def duration(self) -> float:
        """S."""
        return (self.time[-1] - self.time[0]).item()

    @cached_property
    def effort(self) -> list[float]:
        """Largest absolute command of each joint, N·m; the typical torque where there is none to speak of."""
        if self.command is None:
            return self.torque
        largest, typical = self.command.abs().amax(0), torch.tensor(self.torque, dtype=torch.float64)
        return torch.where(largest > NEGLIGIBLE * typical, largest.double(), typical).tolist()
