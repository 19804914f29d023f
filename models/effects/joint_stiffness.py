"""A spring in a joint: −k (θ − θ₀)."""

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values, quantiles
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation


class JointStiffness(Effect):
    """Torque −k (θ − θ₀) at a joint: passive tissue, a cable, a counterbalance.

    Told apart from a tilt or an armature by the rest pose and the frequency. ``stiffness``, ``springref`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and rest angle θ₀, rad: anywhere, spread as wide as an even circle."""
        rest = Normal(0.0, 1.8)
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * scale.torque[self.place[0]])),
            Parameter("rest_angle", "rad", rest, None, quantiles(rest, 7)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """−k (θ − θ₀)."""
        j = self.place[0]
        return now.at(j, -p["stiffness"] * (now.q[..., j : j + 1] - p["rest_angle"]))
