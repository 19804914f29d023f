"""Viscous friction of a joint: −b θ̇."""

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.change import change
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

SHARES = (0.01, 0.1, 0.4, 1.2)
"""Of the prior's spread, where a screen looks: what stops a light link within a row does no more when it is doubled."""


class ViscousFriction(Effect):
    """Torque −b θ̇ at a joint.

    Told apart from Coulomb friction by motion at several amplitudes. As ``damping`` in MuJoCo.
    """

    phrase = "viscous friction"
    meaning = "a torque against the motion that grows with speed"
    shown_by = "the same motion at several amplitudes"
    filed: ClassVar[Mapping[str, str]] = {"damping": "damping"}

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping b, N·m·s/rad."""
        j = self.place[0]
        typical = 0.2 * scale.torque[j] / scale.speed[j]
        return (change("damping", "N·m·s/rad", typical, scale.filed("damping", j), SHARES),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−b θ̇."""
        j = self.place[0]
        return now.at(j, -p["damping"] * now.qd[..., j : j + 1])
