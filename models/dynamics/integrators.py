"""One step of θ̈ = a(θ, θ̇, s) over dt, in equal sub-steps of δ = dt/substeps.

`acceleration(q, qd, s)` returns θ̈; s in [0, 1] is the fraction of the whole step, for torques that move
inside it. q, qd (..., K) in rad and rad/s; dt in s, a number or a tensor that broadcasts against q.
All return (q, qd) at the end of the step.

    euler           order 1   θ' = θ + δ θ̇, θ̇' = θ̇ + δ a(θ, θ̇), both from the old state, as in the paper
    semi_implicit   order 1   θ̇' = θ̇ + δ a(θ, θ̇), θ' = θ + δ θ̇', with the new velocity
    rk4             order 4   the classical Runge–Kutta method
"""

from collections.abc import Callable

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
