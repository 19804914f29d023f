"""Effects that the catalogue lacks, in the second generator's terms: angles count from hanging, or between links.

Each `install(world, rng, scene, joint)` draws its size, as in :mod:`invdyn.blindcheck.unlisted_effects`, puts itself
into the world, and returns its parameters as name → (value, unit).
"""

import numpy as np

from invdyn.blindcheck.motion import between
from invdyn.blindcheck.pinocchio.chain import Piece
from invdyn.blindcheck.pinocchio.simulator import World
from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.stretched import pendulum_frequency


def position_friction(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Dry friction that varies with the angle, A sin²(φ + phase): a bent shaft."""
    size, phase = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0, np.pi)
    world.dry(joint, lambda q, v, load: size * np.sin(q + phase) ** 2)
    return {"amplitude": (size, "N·m"), "phase": (phase, "rad")}


def hardening_spring(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """−k x³ about the middle of the motion."""
    middle, swing = scene.motion.q[:, joint].mean(), np.std(scene.motion.q[:, joint])
    rest, size = world.own(joint, float(middle)), between(rng, 0.1, 0.4) * scene.torque[joint]
    world.torque(joint, lambda t, q, v: -size * min(max((q - rest) / swing, -3.0), 3.0) ** 3)
    return {"stiffness": (size / swing**3, "N·m/rad³"), "rest_angle": (float(middle), "rad")}


def detent(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A magnet that catches: −2 A x / (1 + x²)², with x = (φ − rest)/w."""
    size, width = between(rng, 0.3, 0.8) * scene.torque[joint], rng.uniform(0.08, 0.2)
    angle = float(np.quantile(scene.motion.q[:, joint], rng.uniform(0.3, 0.7)))
    rest = world.own(joint, angle)

    def torque(t: float, q: float, v: float) -> float:
        x = (q - rest) / width
        return -2 * size * x / (1 + x * x) ** 2

    world.torque(joint, torque)
    return {"amplitude": (size, "N·m"), "angle": (angle, "rad"), "width": (width, "rad")}


def alternating_field(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A torque of its own in time, a rounded square wave."""
    size, phase = between(rng, 0.1, 0.3) * scene.torque[joint], rng.uniform(0, 2 * np.pi)
    omega = 2 * np.pi * pendulum_frequency(scene.body) * rng.uniform(1.2, 3.0)
    world.torque(joint, lambda t, q, v: size * np.tanh(2 * np.sin(omega * t + phase)))
    return {"amplitude": (size, "N·m"), "frequency": (omega / 2 / np.pi, "Hz"), "phase": (phase, "rad")}


def cross_viscosity(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Each of two joints is dragged by the other's velocity: tendons over both."""
    other = joint - 1 if joint else 1
    damping = between(rng, 0.1, 0.3) * min(scene.torque[joint], scene.torque[other]) / scene.speed.max()
    sign = world.sign(joint) * world.sign(other)

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        tau[at[joint]] -= sign * damping * v[at[other]]
        tau[at[other]] -= sign * damping * v[at[joint]]

    world.force(act)
    return {"damping": (damping, "N·m·s/rad")}


def one_way_friction(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Viscous in one direction of turning only: a valve."""
    side = float(rng.choice([-1.0, 1.0]))
    damping = between(rng, 0.15, 0.4) * scene.torque[joint] / scene.speed[joint]
    world.torque(joint, lambda t, q, v: -damping * side * max(side * v, 0.0))
    return {"damping": (damping, "N·m·s/rad"), "side": (side * world.sign(joint), "1")}


def cable(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A cable along the arm pulls at one joint with the other's bend: A sin(2 φⱼ + phase)."""
    other = joint - 1 if joint else 1
    size, phase = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0, 2 * np.pi)

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        tau[at[joint]] += size * np.sin(2 * q[at[other]] + phase)

    world.force(act)
    return {"amplitude": (size, "N·m"), "phase": (phase, "rad")}


def sloshing_payload(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A weight that swings on a sprung hinge of its own at the last tip."""
    last = world.pieces[-1]
    mass, length = rng.uniform(0.15, 0.4) * last.mass, 0.3 * last.length
    frequency = pendulum_frequency(scene.body) * rng.uniform(1.5, 3.0)
    inertia = mass * length**2
    stiffness = inertia * (2 * np.pi * frequency) ** 2
    damping = 0.2 * np.sqrt(stiffness * inertia)
    world.pieces.append(Piece(length, mass, length, 1e-3 * inertia))

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        tau[-1] -= stiffness * q[-1] + damping * v[-1]

    world.force(act)
    return {"mass": (mass, "kg"), "length": (length, "m"), "frequency": (frequency, "Hz")}


def hot_motor(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """The motor fades as it heats, u / (1 + c h), with h a low-passed u² in units of its mean, over seconds."""
    loss, memory = rng.uniform(0.2, 0.4), rng.uniform(0.1, 0.3) * scene.plan.duration
    usual, heat = float((scene.motion.command[:, joint] ** 2).mean()), [0.0]

    def of(u: float, interval: float) -> float:
        heat[0] = 0.0 if len(world.rows) == 1 else heat[0]
        heat[0] += -np.expm1(-interval / memory) * (u**2 / usual - heat[0])
        return u / (1 + loss * heat[0])

    world.shape(joint, of)
    return {"loss": (loss, "1"), "time_constant": (memory, "s")}


def hysteresis(world: World, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Dahl's: −A z with ż = φ̇ (1 − z sgn φ̇)/w, exact over a step of constant speed."""
    size, width = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0.3, 0.8)
    state = {"z": 0.0, "t": np.inf}

    def begin(t: float, h: float, q: np.ndarray, v: np.ndarray, at: list[int]) -> None:
        z, moved = (0.0 if t <= state["t"] else state["z"]), h * v[at[joint]]
        side = np.sign(moved)
        state.update(z=side + (z - side) * np.exp(-abs(moved) / width), t=t)

    world.begin(begin)
    world.torque(joint, lambda t, q, v: -size * state["z"])
    return {"amplitude": (size, "N·m"), "width": (width, "rad")}


UNLISTED = {
    function.__name__: function
    for function in (
        position_friction,
        hardening_spring,
        detent,
        alternating_field,
        cross_viscosity,
        one_way_friction,
        cable,
        sloshing_payload,
        hot_motor,
        hysteresis,
    )
}
"""Effects outside the catalogue by name."""
