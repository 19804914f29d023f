"""Forces of joints in other forms: SI units, radians.

dry frictions     hard (`simulator.World.dry`), or smoothed, L tanh(|q̇|/creep)
Stribeck          exp(−(q̇/ω)²), or 1/(1 + (q̇/ω½)²) (Hess & Soom, J. Tribol. 1990), half way at the same speed
drift             −(b₀ + slope t) q̇, or b₀ + rise (1 − exp(−t/T)): a gear that warms up or runs dry
"""

import numpy as np

from invdyn.blindcheck.pinocchio.forms import form, hard_or_creeping
from invdyn.blindcheck.pinocchio.simulator import World
from invdyn.blindcheck.scene import Scene

HALF_WAY = float(np.sqrt(np.log(2)))
"""exp(−x²) = ½ at this x."""


@form()
def viscous_friction(world: World, joint: int, damping: float) -> None:
    """−b q̇."""
    world.law(joint, lambda t, q, v: -damping * v[joint])
    world.resolve(lambda mobility: damping * mobility[joint])


@form(hard_or_creeping)
def coulomb_friction(world: World, joint: int, torque: float, creep: float = 0.0) -> None:
    """Of one level."""
    world.dry(joint, lambda q, v, load: torque, creep)


def _stribeck(rng: np.random.Generator, s: Scene, k: int, p: dict) -> dict:
    p = {key: p[key] for key in ("coulomb", "static", "velocity")}  # through no bristles here
    if rng.random() < 0.5:
        p["half_speed"] = HALF_WAY * p.pop("velocity")
    return hard_or_creeping(rng, s, k, p)


@form(_stribeck)
def stribeck_friction(
    world: World,
    joint: int,
    coulomb: float,
    static: float,
    velocity: float | None = None,
    half_speed: float = 1.0,
    creep: float = 0.0,
) -> None:
    """A level that falls with speed, along a Gaussian with `velocity`, else by Hess and Soom's law."""

    def level(q: float, v: float, load: float) -> float:
        share = 1 / (1 + (v / half_speed) ** 2) if velocity is None else np.exp(-((v / velocity) ** 2))
        return coulomb + (static - coulomb) * share

    world.dry(joint, level, creep)


@form(hard_or_creeping)
def load_friction(world: World, joint: int, coefficient: float, creep: float = 0.0) -> None:
    """A level that grows with the load."""
    world.dry(joint, lambda q, v, load: coefficient * abs(load), creep)


@form()
def joint_stiffness(world: World, joint: int, stiffness: float, rest_angle: float) -> None:
    """A spring with its equilibrium at an angle."""
    world.law(joint, lambda t, q, v: -stiffness * (q[joint] - rest_angle))


@form()
def joint_coupling(world: World, joint: int, stiffness: float, ratio: float, rest_angle: float) -> None:
    """A tendon over this joint and the one before: a spring of length θᵢ − r θⱼ, with its rest."""

    def pull(q: np.ndarray) -> float:
        return float(-stiffness * (q[joint] - ratio * q[joint - 1] - rest_angle))

    world.law(joint, lambda t, q, qd: pull(q))
    world.law(joint - 1, lambda t, q, qd: -ratio * pull(q))


def _drift(rng: np.random.Generator, s: Scene, k: int, p: dict) -> dict:
    if rng.random() < 0.5:
        return p
    constant, whole = float(rng.uniform(0.7, 2.0) * s.plan.duration), p.pop("slope") * s.plan.duration
    # a straight line through it begins elsewhere, so its beginning is no parameter of the catalogue's
    return {
        "first": p["damping"],
        "rise": whole / -float(np.expm1(-s.plan.duration / constant)),
        "time_constant": constant,
    }


@form(_drift)
def drifting_friction(
    world: World,
    joint: int,
    damping: float = 0.0,
    slope: float = 0.0,
    first: float = 0.0,
    rise: float = 0.0,
    time_constant: float = 1.0,
) -> None:
    """Viscous, and more of it with time: from `damping` along a `slope`, or from `first` by a `rise`."""

    def coefficient(t: float) -> float:
        return max(damping + first + slope * t - rise * float(np.expm1(-t / time_constant)), 0.0)

    world.law(joint, lambda t, q, v: -coefficient(t) * v[joint])
