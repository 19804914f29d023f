"""A marker that sits off its joint, fixed in its link's frame: p + a u + b u⊥."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Values, View


class KeypointOffset(Effect):
    """The keypoint at a link's tip sits ``along`` (outwards) and ``across`` (counter-clockwise) from it.

    It rotates with the link. Along the link only a measured length distinguishes it from the link's.
    """

    planar = True
    side, site = "observation", "keypoint"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offsets, m."""
        prior = Normal(0.0, 0.05 * scale.body.length[self.place[0]].item())
        return Parameter("along", "m", prior), Parameter("across", "m", prior)

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved by a u + b u⊥."""
        k = self.place[0]
        return view.moved(k, p["along"] * view.along[..., k, :] + p["across"] * view.across[..., k, :])
