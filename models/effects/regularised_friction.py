"""Dry friction whose joint does not come to rest at once: the ideal law, and its non-ideal variants.

Ideal dry friction takes what speed there is in no time. Solvers of contacts regularise it (Todorov 2014, "Convex and
analytically invertible dynamics with contacts and constraints"). As far as friction's level L allows, a joint is
brought with a time constant T to the speed a ρ. So fast it creeps under what friction holds. With a the joint's
acceleration but for the friction, A its mobility, 1/(kg·m²), and a time ρ

    f = −clip((a + (θ̇ − a ρ)/T) / A, ±L)

so that friction changes sign about a T before the motion does, and a joint that sticks moves on with a ρ. T → 0 and
ρ → 0 are the ideal law. In the solvers' own terms T = T' (1 + R) and ρ = T' R: a recording determines the product of T'
and R, and not each. MuJoCo's default ``frictionloss`` has T' = ½ · .95 · .02 s and R = .1/.9: T ≈ 11 and ρ ≈ 1 ms.

The second variant has bristles that bend before they slip (LuGre: Canudas de Wit, Olsson, Åström & Lischinsky 1995). A
joint at rest hangs on a spring: over some thousandths of a radian friction grows from nothing to its level L, and has
to be bent back where the joint turns around. With s the bristles' deflection, rad,

    ṡ = θ̇ − σ₀ |θ̇| s / L        friction = −σ₀ s − σ₁ ṡ

which slides with −L sgn θ̇, where L may depend on speed (Stribeck's curve) or load; L constant and σ₁ = 0 is Dahl's
model. σ₀ → ∞ is the ideal law. MuJoCo's ``dcmotor`` has it as ``lugre``. Deflections that follow faster than a sub-step
h can, at σ₀ |θ̇| h / L > 1, do so as fast as it can: a joint that slides like that has bent them as far as they go.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Self

import torch
from pyro.distributions import HalfNormal, LogNormal
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import ABRUPT, Effect, Parameter, Scale, Situation, Values, as_variant
from invdyn.models.effects.hidden import Hidden

LONGEST = 0.002
"""s, sub-step that follows a joint swinging on its bristles."""
FRICTION, BENT = 0.1, 0.002
"""Typical level, of the typical torque, and deflection under it, rad."""

Moving = Callable[[Tensor, Tensor, float, Tensor], tuple[Tensor, Tensor]]
"""(q, q̇, fraction of the step, s) → θ̈ (..., K) and ṡ (..., 1)."""


class BristleFriction(Hidden):
    """A dry friction, ``of``, whose levels are as they are, and one hidden state s.

    Args:
        of: the friction in its ideal form, bound or not.
    """

    variant = 2
    states = 1
    max_substep = LONGEST

    def __init__(self, of: Effect):
        self.of, self.name, self.where, self.form, self.place = of, of.name, of.where, of.form, of.place

    @classmethod
    def in_place_of(cls, regularised: Effect) -> Self:
        """Of friction in its regularised form."""
        return cls(as_variant(regularised, 0))

    def bound(self, body: ArticulatedBody) -> Self:
        """See :meth:`Effect.bound`."""
        return type(self)(self.of.bound(body))

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """The friction's own; stiffness σ₀, N·m/rad, and damping σ₁, N·m·s/rad."""
        j = self.place[0]
        stiffness = FRICTION * scale.torque[j] / BENT
        damping = math.sqrt(stiffness * scale.inertia[j])
        return (
            *self.of.parameters(scale),
            Parameter("bristle_stiffness", "N·m/rad", LogNormal(math.log(stiffness), 1.2), None, (stiffness,)),
            Parameter("bristle_damping", "N·m·s/rad", LogNormal(math.log(0.3 * damping), 1.2), None, (0.3 * damping,)),
        )

    def hidden_scale(self, scale: Scale) -> tuple[float, ...]:
        """As far as typical friction bends them."""
        return (BENT,)

    def level(self, p: Values, now: Situation) -> Tensor:
        """L, (..., 1) N·m."""
        friction: Callable[[Values, Situation], Tensor] = self.of.friction  # type: ignore[attr-defined]  # a dry friction
        return friction(p, now)

    def bending(self, p: Values, s: Tensor, speed: Tensor, level: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
        """Friction (..., 1) N·m, and ṡ rad/s, at a joint's ``speed`` in a sub-step of ``step`` s."""
        # where there is none the quotient's slope must not count either
        pace = p["bristle_stiffness"] * speed.abs() / torch.where(level > 0, level, 1.0)  # 1/s
        rate = (speed - pace * s) / (pace * step).clamp_min(1.0)
        friction = -p["bristle_stiffness"] * s - p["bristle_damping"] * rate
        return torch.where(level > 0, friction, 0.0), torch.where(level > 0, rate, 0.0)

    def step(
        self, moving: Moving, s: Tensor, q: Tensor, qd: Tensor, dt: Tensor, n: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """S, q and q̇ one row of ``dt`` s later, in ``n`` sub-steps of Runge–Kutta of order 4."""
        h = dt / n
        for i in range(n):
            x, slopes = (s, q, qd), list[tuple[Tensor, Tensor, Tensor]]()
            for share, ahead in ((0.0, 0.0), (0.5, 0.5), (0.5, 0.5), (1.0, 1.0)):
                here = x if not slopes else tuple(a + ahead * h * b for a, b in zip(x, slopes[-1], strict=True))
                bent, rate = moving(here[1], here[2], (i + share) / n, here[0])
                slopes.append((rate, here[2], bent))
            s, q, qd = (a + h / 6 * (k1 + 2 * (k2 + k3) + k4) for a, k1, k2, k3, k4 in zip(x, *slopes, strict=True))
        return s, q, qd


SETTLING = 0.01
"""s, typical T."""
CREEP = 0.001
"""s, typical ρ."""


class RegularisedFriction(Effect):
    """Base of dry frictions: a level, and in the first variant the times ``settling``, T, and ``creep``, ρ."""

    max_substep: float = ABRUPT
    steady = False
    """Whether its level is the same at all speeds and loads."""

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
