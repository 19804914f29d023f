"""A marker on soft tissue: it lags behind its bone, p − κ p̈, or slides on it as the joint turns."""

from typing import ClassVar

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class SoftTissue(Effect):
    """The keypoint at a link's tip is thrown outwards by −κ p̈: tissue of a natural frequency 1/√κ, far below it.

    ``SoftTissue("elbow", "sliding")`` is skin that the joint at the tip pulls along as it turns by θ (for the last tip,
    that at its link's near end): p + (a + a' θ) u + (b + b' θ) u⊥. Either is told apart from a fixed offset, by fast
    motion and by other postures.
    """

    side, site = "observation", "keypoint"
    forms: ClassVar[tuple[str, ...]] = ("sliding",)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Compliance κ, s²; sliding, a' and b', m/rad, and a and b, m."""
        k = self.place[0]
        if self.form is None:
            return (Parameter("kappa", "s²", HalfNormal(0.1 / scale.speed[k] ** 2)),)
        prior = Normal(0.0, 0.05 * scale.body.length[k].item())
        slides = [Parameter(f"{way}_per_rad", "m/rad", prior) for way in ("along", "across")]
        return (*slides, Parameter("along", "m", prior), Parameter("across", "m", prior))

    def points(self, p: Values, view: View) -> Tensor:
        """The tip moved."""
        k = self.place[0]
        if self.form is None:
            return view.moved(k, -p["kappa"] * view.tip_acceleration[..., k, :])
        joint = min(k + 1, view.q.shape[-1] - 1)
        angle = view.q[..., joint : joint + 1]
        along, across = (p[way] + p[f"{way}_per_rad"] * angle for way in ("along", "across"))
        return view.moved(k, along * view.along[..., k, :] + across * view.across[..., k, :])
