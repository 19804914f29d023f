"""One step of θ̈ = a(θ, θ̇, s) over dt, in equal sub-steps of δ = dt/substeps.

`acceleration(q, qd, s)` returns θ̈; s in [0, 1] is the fraction of the whole step, for torques that move
inside it. q, qd (..., K) in rad and rad/s; dt in s, a number or a tensor that broadcasts against q.
All return (q, qd) at the end of the step.

    euler           order 1   θ' = θ + δ θ̇, θ̇' = θ̇ + δ a(θ, θ̇), both from the old state, as in the paper
    semi_implicit   order 1   θ̇' = θ̇ + δ a(θ, θ̇), θ' = θ + δ θ̇', with the new velocity
    rk4             order 4   the classical Runge–Kutta method

Motion within a step, and when it passes a stop: the polynomial of fourth order in τ = t / h, from 0 to 1, with x, ẋ, ẍ
at 0 and x, ẋ at 1 (Hairer, Nørsett & Wanner, "Solving Ordinary Differential Equations I", II.6, dense output by
Hermite interpolation):

    x(τ) = x₀ + τ h ẋ₀ + ½ τ² h² ẍ₀ + τ³ (4 Δ − E) + τ⁴ (E − 3 Δ),
    Δ = x₁ − x₀ − h ẋ₀ − ½ h² ẍ₀,   E = h (ẋ₁ − ẋ₀ − h ẍ₀)

Shapes: (..., K); h and τ (..., 1). rad, rad/s, rad/s², s.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

Acceleration = Callable[[Tensor, Tensor, float], Tensor]


def euler(
    acceleration: Acceleration, q: Tensor, qd: Tensor, dt: Tensor | float, substeps: int = 1
) -> tuple[Tensor, Tensor]:
    """Explicit Euler; the energy of a free swing grows with every step."""
    step = dt / _checked(substeps)
    for i in range(substeps):
        q, qd = q + step * qd, qd + step * acceleration(q, qd, i / substeps)
    return q, qd


def semi_implicit(
    acceleration: Acceleration, q: Tensor, qd: Tensor, dt: Tensor | float, substeps: int = 1
) -> tuple[Tensor, Tensor]:
    """Semi-implicit Euler: velocity first, then the angle with the new velocity.

    Symplectic for one joint, so that energy errors stay bounded; for more they grow, far slower than Euler's,
    because θ̈ depends on θ̇.
    """
    step = dt / _checked(substeps)
    for i in range(substeps):
        qd = qd + step * acceleration(q, qd, i / substeps)
        q = q + step * qd
    return q, qd


def rk4(
    acceleration: Acceleration, q: Tensor, qd: Tensor, dt: Tensor | float, substeps: int = 1
) -> tuple[Tensor, Tensor]:
    """Classical Runge–Kutta of order 4 on (θ, θ̇); four accelerations a sub-step."""
    step = dt / _checked(substeps)
    half, sixth = step / 2, step / 6
    for i in range(substeps):
        start, middle, end = i / substeps, (i + 0.5) / substeps, (i + 1) / substeps
        v1, a1 = qd, acceleration(q, qd, start)
        v2 = qd + half * a1
        a2 = acceleration(q + half * v1, v2, middle)
        v3 = qd + half * a2
        a3 = acceleration(q + half * v2, v3, middle)
        v4 = qd + step * a3
        a4 = acceleration(q + step * v3, v4, end)
        q = q + sixth * (v1 + 2 * (v2 + v3) + v4)
        qd = qd + sixth * (a1 + 2 * (a2 + a3) + a4)
    return q, qd


INTEGRATORS = {"euler": euler, "semi_implicit": semi_implicit, "rk4": rk4}


def _checked(substeps: int) -> int:
    if not isinstance(substeps, int) or substeps < 1:
        raise ValueError(f"substeps must be a whole number ≥ 1, got {substeps!r}")
    return substeps


ITERATIONS = 5
"""Of Newton's method, which doubles the digits with each."""


class Passage(NamedTuple):
    """A step's motion between its ends."""

    x0: Tensor
    v0: Tensor
    a0: Tensor
    x1: Tensor
    v1: Tensor
    h: Tensor

    def at(self, share: Tensor) -> tuple[Tensor, Tensor]:
        """The motion x and its h ẋ at ``share`` = τ."""
        v0, a0, v1 = self.h * self.v0, self.h**2 * self.a0, self.h * self.v1
        off, turned = self.x1 - self.x0 - v0 - a0 / 2, v1 - v0 - a0
        third, fourth = 4 * off - turned, turned - 3 * off
        x = self.x0 + share * (v0 + share * (a0 / 2 + share * (third + share * fourth)))
        return x, v0 + share * (a0 + share * (3 * third + 4 * share * fourth))

    def until(self, share: Tensor, where: Tensor) -> tuple[Tensor, Tensor]:
        """The motion x and its ẋ at ``share`` = τ in the rows ``where``; at the end elsewhere."""
        x, moved = self.at(share)
        return torch.where(where, x, self.x1), torch.where(where, moved / torch.where(where, self.h, 1.0), self.v1)

    def only(self, coordinate: int) -> "Passage":
        """Of one coordinate, (..., 1)."""
        x0, v0, a0, x1, v1 = (each[..., coordinate : coordinate + 1] for each in self[:-1])
        return Passage(x0, v0, a0, x1, v1, self.h)

    def reaches(self, stop: Tensor, where: Tensor) -> Tensor:
        """τ (..., 1) at which one coordinate, which ends beyond ``stop``, last passes it; one but for ``where``.

        By Newton's method from the end back: where the coordinate speeds up no step is too long, and where it slows
        down the first one at most.
        """
        share = torch.ones_like(stop)
        for left in reversed(range(ITERATIONS)):
            # The last step alone has all of its slope.
            with torch.set_grad_enabled(torch.is_grad_enabled() and not left):
                x, v = self.at(share)
                share = share - torch.where(where, (x - stop) / torch.where(where & (v != 0), v, 1.0), 0.0)
                share = share.clamp(0, 1)
        return share
