"""Dry friction whose joint does not come to rest at once: the ideal law, and its softer form.

Ideal dry friction takes what speed there is in no time. Solvers of contacts soften it: a joint is
brought to rest with a time constant T, as far as friction's level L allows, and creeps under what friction holds
(Todorov 2014, "Convex and analytically invertible dynamics with contacts and constraints", regularised friction), with
a its acceleration but for the friction and A its mobility, 1/(kg·m²),

    f = −clip((a + θ̇/T) / (A (1 + R)), ±L)

so that friction changes sign about a T before the motion does, and a joint that is held moves on with a R T. T → 0 is
the ideal law. MuJoCo's ``frictionloss``, unless told otherwise, has T = ½ · .95 · .02 s ≈ 10 ms and R = .1/.9.
"""

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Effect, Parameter, Values
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation

SETTLING = 0.01
"""s, typical T of a friction that is soft."""
CREEP = 0.1
"""Its typical R."""


class Rubbing(Effect):
    """Base of dry frictions: a level, and in their softer form the time constant ``settling`` and ``creep``."""

    longest: ClassVar[float] = ABRUPT
    softens: ClassVar[bool] = True

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """A short T, which leads on to longer ones."""
        return {**ideal, "settling": SETTLING / 2, "creep": CREEP / 2}

    @abstractmethod
    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of the ideal law."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of the ideal law; if it is soft T, s, and R, a pure number."""
        if not self.soft:
            return self.levels(scale)
        settling = Parameter("settling", "s", HalfNormal(SETTLING), None, (SETTLING / 2,))
        return (*self.levels(scale), settling, Parameter("creep", "1", HalfNormal(CREEP)))

    def settling(self, p: Values) -> tuple[Tensor, Tensor] | None:
        """T (1 + R) and R T, s."""
        return (p["settling"] * (1 + p["creep"]), p["settling"] * p["creep"]) if self.soft else None

    @abstractmethod
    def friction(self, p: Values, now: Situation) -> Tensor:
        """The level L, N·m."""
