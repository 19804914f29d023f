"""Drag of a joint in the square of its speed: −c θ̇ |θ̇|."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale


class QuadraticDrag(Effect):
    """Torque −c θ̇ |θ̇| at a joint, as of a paddle in water or air.

    Told apart from viscous friction by large amplitudes. As ``density`` in MuJoCo.
    """

    phrase = "quadratic drag"
    meaning = "a torque against the motion that grows with the square of speed"
    shown_by = "fast, large motion beside slow motion"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Drag c, N·m·s²/rad²."""
        j = self.place[0]
        return (Parameter("drag", "N·m·s²/rad²", HalfNormal(0.15 * scale.torque[j] / scale.speed[j] ** 2)),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−c θ̇ |θ̇|."""
        j = self.place[0]
        speed = now.qd[..., j : j + 1]
        return now.at(j, -p["drag"] * speed * speed.abs())
