"""Keypoints that come late: a row shows p(t − δ).

A row's state is the arm's when its picture was taken. To that state the motors are late, and encoders, whose clock is
the motors', are ahead:

    u'(t) = u(t − δ),     encoders show θ(t + δ)
"""

from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect
from invdyn.models.effects.command import Command
from invdyn.models.effects.parameter import Parameter, Values, quantiles
from invdyn.models.effects.scale import Scale
from invdyn.models.observation.view import View


class CameraLatency(Effect):
    """The picture in a row was taken δ before its time.

    Encoders are followed over δ (:mod:`..articulated.observation_model`).

    Without encoders it cannot be told from motors that act late, and without commands either from nothing at all.
    """

    phrase = "camera latency"
    meaning = "positions that are stamped later than they were"
    shown_by = "a common clock of camera and motors, such as a light that the command switches"
    twins: ClassVar[Mapping[str, Mapping[str, str]]] = {"actuator_delay": {"latency": "delay"}}

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
