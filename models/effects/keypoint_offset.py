"""A marker that sits off its joint, fixed in its link's frame: p + a u + b u⊥."""

from pyro.distributions import Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.view import View


class KeypointOffset(Effect):
    """The keypoint at a link's tip sits ``along`` (outwards) and ``across`` (counter-clockwise) from it.

    Along the link it cannot be told from the link's length. It turns with the link.
    """

    phrase = "a keypoint offset"
    meaning = "a marker that sits beside its joint"
    shown_by = "a measured length of the link"

    planar = True
    side, site = "observation", "keypoint"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Offsets, m."""
        prior = Normal(0.0, 0.05 * scale.body.length[self.place[0]].item())
        return Parameter("along", "m", prior), Parameter("across", "m", prior)

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved by a u + b u⊥."""
        k = self.place[0]
        shift = p["along"] * view.along[..., k, :] + p["across"] * view.across[..., k, :]
        return view.moved(k, shift)
