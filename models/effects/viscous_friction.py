"""Viscous friction of a joint: −b θ̇."""

from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, change

SHARES = (0.01, 0.1, 0.4, 1.2)
"""Of the prior's width, where a screen looks: doubled damping of a light link stops it within a row all the same."""


class ViscousFriction(Effect):
    """Torque −b θ̇ at a joint. As ``damping`` in MuJoCo.

    Motion at several amplitudes distinguishes it from Coulomb friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping b, N·m·s/rad."""
        j = self.place[0]
        typical = 0.2 * scale.torque[j] / scale.speed[j]
        filed = scale.filed("damping", j) + scale.servo_damping(j)
        return (change("damping", "N·m·s/rad", typical, filed, SHARES),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−b θ̇."""
        return now.at(self.place[0], -p["damping"] * self.own(now.qd))
