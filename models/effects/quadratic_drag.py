"""Drag of a joint in the square of its speed: −c θ̇ |θ̇|."""

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values


class QuadraticDrag(Effect):
    """Torque ``−c θ̇ |θ̇|`` at a joint, as of a paddle in water or air. As ``density`` in MuJoCo.

    Large amplitudes distinguish it from viscous friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Drag c, N·m·s²/rad²."""
        j = self.place[0]
        return (Parameter("drag", "N·m·s²/rad²", HalfNormal(0.15 * scale.torque[j] / scale.speed[j] ** 2)),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−c θ̇ |θ̇|."""
        speed = self.own(now.qd)
        return now.at(self.place[0], -p["drag"] * speed * speed.abs())
