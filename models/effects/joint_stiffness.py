"""A spring in a joint: −k (θ − θ₀)."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, change


class JointStiffness(Effect):
    """Torque −k (θ − θ₀) at a joint: passive tissue, a cable, a counterbalance.

    Given by its stiffness and by its torque where θ = 0, T₀ = k θ₀; it is linear in both. Rest pose and frequency
    distinguish it from a tilt or an armature. ``stiffness``, ``springref`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and torque at angle zero T₀, N·m, for rest angles anywhere on a circle."""
        j = self.place[0]
        torque = scale.torque[j]
        return (
            change("stiffness", "N·m/rad", 0.5 * torque, scale.filed("stiffness", j)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """T₀ − k θ."""
        return now.at(self.place[0], p["torque"] - p["stiffness"] * self.own(now.q))
