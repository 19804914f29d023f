"""Dry friction of a joint: −τ_c sgn θ̇."""

from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Situation, Values, change
from invdyn.models.effects.regularised_friction import RegularisedFriction


class CoulombFriction(RegularisedFriction):
    """Torque −τ_c sgn θ̇ at a joint, at any speed; a joint at rest sticks. As ``frictionloss`` in MuJoCo.

    Motion at several amplitudes distinguishes it from viscous friction.
    """

    steady = True

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction torque τ_c, N·m."""
        j = self.place[0]
        return (change("torque", "N·m", 0.2 * scale.torque[j], scale.filed("friction", j)),)

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c."""
        return p["torque"]
