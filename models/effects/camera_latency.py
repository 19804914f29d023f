"""Keypoints that come late: a row shows p(t − δ).

A row's state is the arm's when its picture was taken. To that state the motors are late, and encoders, whose clock is
the motors', are ahead:

    u'(t) = u(t − δ),     encoders show θ(t + δ)
"""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Command, Effect, Parameter, Scale, Values, View, quantiles


class CameraLatency(Effect):
    """The picture in a row was taken δ before its time. Encoders are followed over δ
    (:mod:`..articulated.observation_model`).

    Only encoders distinguish it from motors that act late. Without commands, too, it has no effect at all.
    """

    side, site = "observation", "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Latency δ, s."""
        prior = HalfNormal(0.03)
        return (Parameter("latency", "s", prior, 0.0, quantiles(prior, 6)),)

    def command(self, p: Values, command: Command) -> Command:
        """u(t − δ)."""
        return command.delayed(p["latency"])

    def angles(self, p: Values, view: View) -> Tensor:
        """θ(t + δ)."""
        return view.angles_after(p["latency"])
