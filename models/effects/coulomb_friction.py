"""Dry friction of a joint: −τ_c sgn θ̇."""

from collections.abc import Mapping
from typing import ClassVar

from torch import Tensor

from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.change import change
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.regularised_friction import RegularisedFriction
from invdyn.models.effects.scale import Scale


class CoulombFriction(RegularisedFriction):
    """Torque −τ_c sgn θ̇ at a joint, whatever its speed; a joint at rest sticks.

    Told apart from viscous friction by motion at several amplitudes. As ``frictionloss`` in MuJoCo.
    """

    phrase = "Coulomb friction"
    meaning = "a torque of one size against the motion, whatever the speed"
    shown_by = "slow reversals at several amplitudes"
    filed: ClassVar[Mapping[str, str]] = {"torque": "friction"}

    steady: ClassVar[bool] = True

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction torque τ_c, N·m."""
        j = self.place[0]
        return (change("torque", "N·m", 0.2 * scale.torque[j], scale.filed("friction", j)),)

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c."""
        return p["torque"]
