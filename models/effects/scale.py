"""What is large and what is small for a body: the scales that the effects' priors follow.

A mouse limb and an industrial arm have the same catalogue; only these numbers differ. Per joint, with what
is beyond it stretched out:

    inertia   Σ I + m r² about the joint                            kg·m²
    torque    the gravity load of the level arm; without gravity, what moves it by a radian in a fifth of a second   N·m
    speed     √(torque / inertia), of a swing under that torque, or what has been seen if slower     rad/s
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.dynamics.interface import Dynamics

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
    parts: Sequence[JointParts | None] = ()

    def filed(self, quantity: str, joint: int) -> float:
        """What the simulation's own joint has of a quantity such as "damping"; 0 for nothing."""
        own = self.parts[joint] if joint < len(self.parts) else None
        return 0.0 if own is None else float(getattr(own, quantity))

    def servo_damping(self, joint: int) -> float:
        """How much a servo of the simulation's own joint damps it, N·m·s/rad."""
        own = self.parts[joint] if joint < len(self.parts) else None
        return 0.0 if own is None else own.servo_damping

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
