"""Dry friction whose joint does not come to rest at once: the ideal law, and its non-ideal variants.

Ideal dry friction takes what speed there is in no time. Solvers of contacts regularise it (Todorov 2014, "Convex and
analytically invertible dynamics with contacts and constraints"). As far as friction's level L allows, a joint is
brought with a time constant T to the speed a ρ. So fast it creeps under what friction holds. With a the joint's
acceleration but for the friction, A its mobility, 1/(kg·m²), and a time ρ

    f = −clip((a + (θ̇ − a ρ)/T) / A, ±L)

so that friction changes sign about a T before the motion does, and a joint that sticks moves on with a ρ. T → 0 and
ρ → 0 are the ideal law. In the solvers' own terms T = T' (1 + R) and ρ = T' R: a recording determines the product of T'
and R, and not each. MuJoCo's default ``frictionloss`` has T' = ½ · .95 · .02 s and R = .1/.9: T ≈ 11 and ρ ≈ 1 ms.

Real joints rather spring back: the second variant is :mod:`.bristles`.
"""

from abc import abstractmethod

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Effect, Parameter, Scale, Situation, Values, as_variant
from invdyn.models.effects.bristles import BristleFriction

SETTLING = 0.01
"""s, typical T."""
CREEP = 0.001
"""s, typical ρ."""


class RegularisedFriction(Effect):
    """Base of dry frictions: a level, and in the first variant the times ``settling``, T, and ``creep``, ρ."""

    max_substep: float = ABRUPT
    steady = False
    """Whether its level is the same at all speeds and loads."""

    def nonideal(self) -> Effect | None:
        """The ideal law regularised, and that through bristles."""
        return BristleFriction(as_variant(self, 0)) if self.variant else as_variant(self, 1)

    @abstractmethod
    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of the ideal law."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of the ideal law; in the first variant T and ρ, s."""
        if not self.variant:
            return self.levels(scale)
        settling = Parameter("settling", "s", HalfNormal(SETTLING), None, (SETTLING / 2,))
        return (*self.levels(scale), settling, Parameter("creep", "s", HalfNormal(CREEP)))

    def settling(self, p: Values, now: Situation) -> tuple[Tensor, Tensor] | None:
        """T and ρ, s."""
        return (p["settling"], p["creep"]) if self.variant else None

    @abstractmethod
    def friction(self, p: Values, now: Situation) -> Tensor:
        """The level L, N·m."""
