"""Keypoints that come late: a row shows p(t − δ)."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import View


class CameraLatency(Effect):
    """The picture in a row was taken δ before the row's time: to third order in δ, under the commands before it.

    Cannot be told from motors that act late without a common clock.
    """

    side, site, order = "observation", "arm", 1

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Latency δ, s."""
        return (Parameter("latency", "s", HalfNormal(0.03)),)

    def points(self, p: Values, view: View) -> Tensor:
        """p(t − δ)."""
        return view.later(-p["latency"].unsqueeze(-1))
