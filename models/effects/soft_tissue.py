"""A marker on soft tissue lags behind its bone: p − κ p̈."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class SoftTissue(Effect):
    """The keypoint at a link's tip is thrown outwards by −κ p̈: tissue of a natural frequency 1/√κ, far below it.

    Told apart from a fixed offset by fast motion.
    """

    side, site = "observation", "keypoint"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Compliance κ, s²."""
        return (Parameter("kappa", "s²", HalfNormal(0.1 / scale.speed[self.place[0]] ** 2)),)

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved by −κ p̈."""
        k = self.place[0]
        return view.moved(k, -p["kappa"] * view.tip_acceleration[..., k, :])
