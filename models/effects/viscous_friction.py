"""Viscous friction of a joint: −b θ̇."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation


class ViscousFriction(Effect):
    """Torque −b θ̇ at a joint.

    Told apart from Coulomb friction by motion at several amplitudes. As ``damping`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping b, N·m·s/rad."""
        j = self.place[0]
        return (Parameter("damping", "N·m·s/rad", HalfNormal(0.2 * scale.torque[j] / scale.speed[j])),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−b θ̇."""
        j = self.place[0]
        return now.at(j, -p["damping"] * now.qd[..., j : j + 1])
