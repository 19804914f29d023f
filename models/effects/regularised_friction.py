"""Dry friction whose joint does not come to rest at once: the ideal law, and its softer forms.

Ideal dry friction takes what speed there is in no time. Solvers of contacts soften it (Todorov 2014, "Convex and
analytically invertible dynamics with contacts and constraints", regularised friction). As far as friction's level L
allows, a joint is brought with a time constant T to the speed a ρ. So fast it creeps under what friction holds. With a
the joint's acceleration but for the friction, A its mobility, 1/(kg·m²), and a time ρ

    f = −clip((a + (θ̇ − a ρ)/T) / A, ±L)

so that friction changes sign about a T before the motion does, and a joint that is held moves on with a ρ. T → 0 and
ρ → 0 are the ideal law. In the solvers' own terms T = T' (1 + R) and ρ = T' R: of T' and R a recording tells the
product and not each. MuJoCo's ``frictionloss``, unless told otherwise, has T' = ½ · .95 · .02 s and R = .1/.9: T ≈ 11
and ρ ≈ 1 ms.

Real ones rather spring back: see :mod:`.bristles`, which is looked for where this form leaves something as well.
"""

import copy
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Effect, Parameter, Values
from invdyn.models.effects.bristles import BristleFriction
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.scale import Scale

SETTLING = 0.01
"""s, typical T of a friction that is soft."""
CREEP = 0.001
"""s, its typical ρ."""


class RegularisedFriction(Effect):
    """Base of dry frictions: a level, and in their softer form the times ``settling``, T, and ``creep``, ρ."""

    longest: ClassVar[float] = ABRUPT
    softens: ClassVar[bool] = True
    form_words: ClassVar[Mapping[str, str]] = {
        "settling": "softer than the ideal law, it takes a moment to bring the joint to rest and lets it creep",
        "bristle_stiffness": "softer than the ideal law, it springs back by a little before it slips",
    }

    def softened(self) -> Self | BristleFriction | None:  # type: ignore[override]  # its softest form is a class of its own
        """The ideal law's is soft, and that one's has bristles."""
        return BristleFriction(self.ideal()) if self.soft else super().softened()

    def ideal(self) -> Self:
        """The ideal form."""
        other = copy.copy(self)
        other.soft = False
        return other

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """A short T, which leads on to longer ones."""
        return {**ideal, "settling": SETTLING / 2, "creep": CREEP / 2}

    def starts_of(self, other: Effect, values: Mapping[str, float], scale: Scale) -> Sequence[Mapping[str, float]]:
        """Of another dry friction of the joint that is found from a level: as large as this one's, in the mean."""
        if not isinstance(other, RegularisedFriction) or other.where != self.where or other.name == self.name:
            return ()
        return other.at_level(values[self.levels(scale)[0].name], scale)

    def at_level(self, level: float, scale: Scale) -> Sequence[Mapping[str, float]]:
        """Values with which it is as large as a ``level``, N·m, in the mean; none where its change near absence says
        as much, joints that stick or not.
        """
        return ()

    @abstractmethod
    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parameters of the ideal law."""

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Those of the ideal law; if it is soft T and ρ, s."""
        if not self.soft:
            return self.levels(scale)
        settling = Parameter("settling", "s", HalfNormal(SETTLING), None, (SETTLING / 2,))
        return (*self.levels(scale), settling, Parameter("creep", "s", HalfNormal(CREEP)))

    def settling(self, p: Values) -> tuple[Tensor, Tensor] | None:
        """T and ρ, s."""
        return (p["settling"], p["creep"]) if self.soft else None

    @abstractmethod
    def friction(self, p: Values, now: Situation) -> Tensor:
        """The level L, N·m."""
