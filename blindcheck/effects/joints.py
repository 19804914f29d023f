"""Forces of joints: friction, drag, springs, stops. Each function installs one effect in a `World`, in MuJoCo's terms.

Where MuJoCo has the effect, its own part simulates it; else a force is applied at every step. Joints count from 0.

    viscous, coulomb             dof_damping, dof_frictionloss
    stribeck, load friction      dof_frictionloss rewritten every step, so that sticking stays MuJoCo's own; Stribeck's
                                 also through bristles, applied: −(σ₀ z + σ₁ ż),  ż = θ̇ − σ₀ |θ̇| z / g(θ̇),
                                 g = τc + (τs − τc) exp(−(θ̇/ωs)²)     LuGre: Canudas de Wit, Olsson, Åström &
                                 Lischinsky, IEEE TAC 40 (1995), p. 419
    stiffness, coupling          springs of joints, of a fixed tendon
"""

from typing import Any

import numpy as np

from invdyn.blindcheck.effects.effect import mechanism, set_joint
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import NONIDEAL_FRACTION, Scene, sign
from invdyn.blindcheck.simulator import World, set_part


@mechanism(
    units={"damping": "N·m·s/rad"},
    size=lambda rng, s, k, a: {"damping": a * between(rng, 0.04, 0.2) * s.torque[k] / s.speed[k]},
)
def viscous_friction(world: World, joint: int, damping: float) -> None:
    """−b θ̇."""
    set_joint(world, joint, damping=damping)


@mechanism(units={"torque": "N·m"}, size=lambda rng, s, k, a: {"torque": a * between(rng, 0.04, 0.15) * s.torque[k]})
def coulomb_friction(world: World, joint: int, torque: float) -> None:
    """−τc sgn θ̇, and up to ±τc at rest."""
    set_joint(world, joint, frictionloss=torque)


def _stribeck_friction(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    coulomb = a * between(rng, 0.03, 0.1) * s.torque[k]
    static = coulomb * rng.uniform(1.5, 3.0)
    level = {"coulomb": coulomb, "static": static, "velocity": rng.uniform(0.2, 0.6) * s.speed[k]}
    if rng.random() > NONIDEAL_FRACTION:
        return level
    stiffness = static / between(rng, 3e-4, 3e-3)  # bent by so many radians it slips
    damping = 2 * rng.uniform(0.3, 0.8) * np.sqrt(stiffness * s.inertia[k])
    return level | {"bristle_stiffness": stiffness, "bristle_damping": damping}


@mechanism(
    units={
        "coulomb": "N·m",
        "static": "N·m",
        "velocity": "rad/s",
        "bristle_stiffness": "N·m/rad",
        "bristle_damping": "N·m·s/rad",
    },
    size=_stribeck_friction,
)
def stribeck_friction(
    world: World,
    joint: int,
    coulomb: float,
    static: float,
    velocity: float,
    bristle_stiffness: float | None = None,
    bristle_damping: float | None = None,
) -> None:
    """−(τc + (τs − τc) exp(−(θ̇/ωs)²)) sgn θ̇; through bristles, where they have a stiffness."""
    if bristle_stiffness is not None and bristle_damping is not None:
        return bristles(world, joint, coulomb, static, velocity, bristle_stiffness, bristle_damping)
    world.dry(joint, lambda q, qd, load: coulomb + (static - coulomb) * np.exp(-((qd / velocity) ** 2)))


def bristles(
    world: World, joint: int, coulomb: float, static: float, velocity: float, stiffness: float, damping: float
) -> None:
    """Dry friction through bristles of stiffness σ₀, N·m/rad, and damping σ₁, N·m·s/rad, unbent to begin with."""
    bent = {"z": 0.0, "at": np.inf}

    def act(t: float, model: Any, data: Any) -> None:
        h, step = world.hinge(joint), model.opt.timestep
        z = 0.0 if t <= bent["at"] else bent["z"]
        speed = data.qvel[h] + step / 2 * data.qacc[h]
        level = coulomb + (static - coulomb) * np.exp(-((speed / velocity) ** 2))
        # exact over a step of constant speed, so that bristles as stiff as steps are short stay bent as they should
        rate = stiffness * abs(speed) / level
        after = z + (speed - rate * z) * step * (-np.expm1(-rate * step) / (rate * step) if rate else 1.0)
        data.qfrc_applied[h] -= stiffness * (z + after) / 2 + damping * (after - z) / step
        bent.update(z=after, at=t)

    world.on_step(act)


@mechanism(units={"coefficient": "1"}, size=lambda rng, s, k, a: {"coefficient": a * rng.uniform(0.08, 0.3)})
def load_friction(world: World, joint: int, coefficient: float) -> None:
    """−k |τset_motor − τ_external| sgn θ̇, with τ_external what gravity, Coriolis and centrifugal forces exert."""
    world.dry(joint, lambda q, qd, load: coefficient * abs(load))


@mechanism(
    units={"drag": "N·m·s²/rad²"},
    size=lambda rng, s, k, a: {"drag": a * between(rng, 0.03, 0.12) * s.torque[k] / s.speed[k] ** 2},
)
def quadratic_drag(world: World, joint: int, drag: float) -> None:
    """−c θ̇ |θ̇|."""
    world.law(joint, lambda t, q, qd: -drag * qd[joint] * abs(qd[joint]))


def _joint_stiffness(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    return {
        "stiffness": a * between(rng, 0.1, 0.5) * s.torque[k],
        "rest_angle": s.plan.centre[k] + rng.uniform(-0.8, 0.8),
    }


@mechanism(units={"stiffness": "N·m/rad", "rest_angle": "rad"}, size=_joint_stiffness)
def joint_stiffness(world: World, joint: int, stiffness: float, rest_angle: float) -> None:
    """−k (θ − θ₀)."""
    set_joint(world, joint, stiffness=stiffness, springref=rest_angle)


def _joint_coupling(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    stiffness, ratio = a * between(rng, 0.1, 0.4) * s.torque[k], sign(rng) * rng.uniform(0.4, 1.2)
    middle = s.plan.centre[k] - ratio * s.plan.centre[k - 1]
    return {"stiffness": stiffness, "ratio": ratio, "rest_angle": middle + rng.uniform(-0.8, 0.8)}


@mechanism(
    units={"stiffness": "N·m/rad", "ratio": "1", "rest_angle": "rad"}, needs=("two joints",), size=_joint_coupling
)
def joint_coupling(world: World, joint: int, stiffness: float, ratio: float, rest_angle: float) -> None:
    """A spring on θᵢ − r θⱼ − θ₀, with i the joint and j the one before it: on i, −k times that; on j, r times the
    opposite.
    """

    def change(spec: Any) -> None:
        tendon = spec.add_tendon(name=f"coupling{joint}", springlength=[rest_angle, rest_angle])
        set_part(tendon, {"stiffness": stiffness})
        tendon.wrap_joint(world.pieces[world.hinge(joint)].hinge, 1.0)
        tendon.wrap_joint(world.pieces[world.hinge(joint - 1)].hinge, -ratio)

    world.on_spec(change)


def _joint_limit(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    side = sign(rng)
    # strength is how far into the stop the free motion would go
    quantile = 1 - a * rng.uniform(0.12, 0.3)
    q = s.motion.q[:, k]
    stiffness = rng.uniform(5.0, 20.0) * max(s.torque[k], s.inertia[k] * s.speed[k] ** 2)
    damping = rng.uniform(0.1, 0.5) * 2 * np.sqrt(stiffness * s.inertia[k])
    return {
        "angle": np.quantile(q, quantile if side > 0 else 1 - quantile),
        "stiffness": stiffness,
        "damping": damping,
        "side": side,
    }


@mechanism(units={"angle": "rad", "stiffness": "N·m/rad", "damping": "N·m·s/rad", "side": "1"}, size=_joint_limit)
def joint_limit(
    world: World,
    joint: int,
    angle: float,
    stiffness: float,
    side: float,
    damping: float | None = None,
    loss: float = 0.0,
) -> None:
    """A spring-damper past θ_lim (side +1: above it, −1: below) that pushes and never pulls.

    Its loss e, s/rad, grows with the depth where it has no damper, k x (1 + 3/2 e ẋ) (Hunt & Crossley, J. Appl. Mech.
    1975).
    """

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> float:
        depth, closing = side * (q[joint] - angle), side * qd[joint]
        if depth <= 0:
            return 0.0
        lost = 1.5 * loss * stiffness * depth if damping is None else damping
        return -side * max(0.0, stiffness * depth + lost * closing)

    world.law(joint, torque)
    world.resolve(lambda mobility: 2 * np.sqrt(stiffness * mobility[joint]))
