"""The inertia of a geared motor's rotor, felt at its joint: I_a θ̈."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.change import change
from invdyn.models.effects.scale import Scale


class Armature(Effect):
    """Inertia on the diagonal of the mass matrix, which weighs nothing.

    Told apart from a payload by statics, from stiffness by the frequency. As ``armature`` in MuJoCo.
    """

    phrase = "rotor inertia"
    meaning = "inertia of the motor that resists the joint's acceleration"
    shown_by = "fast motion about a posture that needs no holding torque"
    filed: ClassVar[Mapping[str, str]] = {"inertia": "armature"}

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Inertia I_a as seen behind the gear, kg·m²."""
        j = self.place[0]
        return (change("inertia", "kg·m²", 0.4 * scale.inertia[j], scale.filed("armature", j)),)

    def inertia(self, p: Values, joints: int) -> Tensor:
        """I_a at the joint."""
        return p["inertia"] * one_hot(torch.tensor(self.place[0]), joints).to(p["inertia"])
