"""The inertia of a geared motor's rotor at its joint: I_a θ̈."""

import torch
from torch import Tensor
from torch.nn.functional import one_hot

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, change


class Armature(Effect):
    """Inertia on the diagonal of the mass matrix, without weight. As ``armature`` in MuJoCo.

    Statics distinguish it from a payload, the frequency from stiffness.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Inertia I_a behind the gear, kg·m²."""
        j = self.place[0]
        return (change("inertia", "kg·m²", 0.4 * scale.inertia[j], scale.filed("armature", j)),)

    def inertia(self, p: Values, joints: int) -> Tensor:
        """I_a at the joint."""
        return p["inertia"] * one_hot(torch.tensor(self.place[0]), joints).to(p["inertia"])
