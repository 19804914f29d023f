"""A spring across two joints: potential ½ k (θ_i − r θ_j − θ₀)²."""

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, quantiles


class JointCoupling(Effect):
    """Torque T₀ − k (θ_i − r θ_j) at the second joint named, i, and r times its opposite at the first, j.

    What a muscle or a tendon over two joints does, which is slack in some posture: T₀ = k θ₀. Motion of one joint
    against the other distinguishes it from their own stiffness. As a fixed ``tendon`` with a ``springlength`` in
    MuJoCo.
    """

    site = "pair"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, torque T₀ with both angles at zero, N·m, and ratio r of the two lever arms, a pure
        number of either sign.
        """
        ratio, torque = Normal(0.0, 0.9), scale.torque[self.place[1]]
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * torque)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
            Parameter("ratio", "1", ratio, None, quantiles(ratio, 6)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """(T₀ − k (θ_i − r θ_j)) (e_i − r e_j)."""
        j, i = self.place
        pull = p["torque"] - p["stiffness"] * (now.q[..., i : i + 1] - p["ratio"] * now.q[..., j : j + 1])
        return now.at(i, pull) - now.at(j, p["ratio"] * pull)
