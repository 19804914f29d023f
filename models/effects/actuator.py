"""Motors at one joint, or at all joints with equal values."""

from collections.abc import Sequence
from typing import Self

import torch
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Scale


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

    def at_joints(self, value: Tensor, joints: int) -> Tensor:
        """A value (..., 1) at this actuator's joints and 0 at the others, (..., K)."""
        mine = torch.zeros(joints).index_fill(0, torch.tensor(self.place or range(joints)), 1.0)
        return value * mine.to(value)

    def delay_scale(self, scale: Scale) -> float:
        """A long delay for an arm of this speed, s."""
        return 0.2 / self.of(scale.speed)
