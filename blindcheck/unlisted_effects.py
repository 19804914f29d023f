"""Effects that the catalogue lacks: for the check that such are flagged as unknown, and not pinned on a neighbour.

Each `install(world, rng, scene, joint)` draws its size, of a tenth to four tenths of the joint's usual torque
(a detent up to eight), puts itself into the world of either engine, and returns its parameters as name → (value, unit).
"""

from typing import Any

import numpy as np

from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.stretched import pendulum_frequency


def position_friction(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Dry friction that varies with the angle, ½ A (1 + sin(2 θ + φ)): a bent shaft."""
    size, phase = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0, 2 * np.pi)
    world.dry(joint, lambda q, qd, load: size / 2 * (1 + np.sin(2 * q + phase)))
    return {"amplitude": (size, "N·m"), "phase": (phase, "rad")}


def hardening_spring(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """−k (θ − θ₀)³: passive tissue near the end of its range."""
    swing = np.std(scene.motion.q[:, joint])
    rest = float(scene.motion.q[:, joint].mean())
    stiffness = between(rng, 0.1, 0.4) * scene.torque[joint] / swing**3
    world.law(joint, lambda t, q, qd: -stiffness * np.clip(q[joint] - rest, -3 * swing, 3 * swing) ** 3)
    return {"stiffness": (stiffness, "N·m/rad³"), "rest_angle": (rest, "rad")}


def detent(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A magnet catches near one angle: −A x exp(½ − x²/2), with x = (θ − θ₀)/w."""
    size = between(rng, 0.3, 0.8) * scene.torque[joint]
    rest, width = float(np.quantile(scene.motion.q[:, joint], rng.uniform(0.3, 0.7))), rng.uniform(0.08, 0.2)

    def torque(t: float, q: np.ndarray, qd: np.ndarray) -> float:
        x = (q[joint] - rest) / width
        return -size * x * np.exp(0.5 - x**2 / 2)

    world.law(joint, torque)
    return {"amplitude": (size, "N·m"), "angle": (rest, "rad"), "width": (width, "rad")}


def alternating_field(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A torque of its own in time, A sin(2π f t + φ): a pump, or a field that turns."""
    size, phase = between(rng, 0.1, 0.3) * scene.torque[joint], rng.uniform(0, 2 * np.pi)
    frequency = pendulum_frequency(scene.body) * rng.uniform(1.2, 3.0)
    world.law(joint, lambda t, q, qd: size * np.sin(2 * np.pi * frequency * t + phase))
    return {"amplitude": (size, "N·m"), "frequency": (frequency, "Hz"), "phase": (phase, "rad")}


def cross_viscosity(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """−b θ̇ⱼ on joint i and −b θ̇ᵢ on joint j, with no −b θ̇ᵢ on i: tendons over two joints."""
    other = joint - 1 if joint else 1
    damping = between(rng, 0.1, 0.3) * min(scene.torque[joint], scene.torque[other]) / scene.speed.max()
    world.law(joint, lambda t, q, qd: -damping * qd[other])
    world.law(other, lambda t, q, qd: -damping * qd[joint])
    return {"damping": (damping, "N·m·s/rad")}


def one_way_friction(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """−b θ̇ in one direction of turning only: a valve."""
    side = float(rng.choice([-1.0, 1.0]))
    damping = between(rng, 0.15, 0.4) * scene.torque[joint] / scene.speed[joint]
    world.law(joint, lambda t, q, qd: -damping * side * max(side * qd[joint], 0.0))
    return {"damping": (damping, "N·m·s/rad"), "side": (side, "1")}


def cable(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A cable along the arm pulls at one joint with the other's bend: A sin(2 θⱼ + φ)."""
    other = joint - 1 if joint else 1
    size, phase = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0, 2 * np.pi)
    world.law(joint, lambda t, q, qd: size * np.sin(2 * q[other] + phase))
    return {"amplitude": (size, "N·m"), "phase": (phase, "rad")}


def sloshing_payload(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """A weight that swings on a sprung hinge of its own at the last tip."""
    last = scene.body.links[-1]
    mass, length = rng.uniform(0.15, 0.4) * last.nominal("mass"), 0.3 * last.nominal("length")
    frequency = pendulum_frequency(scene.body) * rng.uniform(1.5, 3.0)
    inertia = mass * length**2
    stiffness = inertia * (2 * np.pi * frequency) ** 2
    world.hang(mass, length, 1e-3 * inertia, stiffness, 0.2 * np.sqrt(stiffness * inertia))
    return {"mass": (mass, "kg"), "length": (length, "m"), "frequency": (frequency, "Hz")}


def hot_motor(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """The motor fades as it heats: (1 − c h) u, with h a low-passed u² in units of its mean, over seconds."""
    loss, memory = rng.uniform(0.15, 0.3), rng.uniform(0.1, 0.3) * scene.plan.duration
    usual, heat = float((scene.motion.command[:, joint] ** 2).mean()), [0.0]

    def of(u: float, seconds: float, first: bool) -> float:
        heat[0] = (0.0 if first else heat[0]) + seconds / memory * (u**2 / usual - heat[0])
        return (1 - min(loss * heat[0], 0.9)) * u

    world.drive(joint, of)
    return {"loss": (loss, "1"), "time_constant": (memory, "s")}


def hysteresis(world: Any, rng: np.random.Generator, scene: Scene, joint: int) -> dict:
    """Bouc and Wen's: −A z with ż = (θ̇ − |θ̇| z)/w, a spring that forgets after a turn by w."""
    size, width = between(rng, 0.15, 0.4) * scene.torque[joint], rng.uniform(0.3, 0.8)
    state = {"z": 0.0, "t": np.inf}

    def moved(t: float, seconds: float, qd: float) -> None:
        z, side = (0.0 if t <= state["t"] else state["z"]), np.sign(qd)  # exact over a step of constant speed
        state.update(z=float(side + (z - side) * np.exp(-abs(qd) * seconds / width)), t=t)

    world.each_step(joint, moved)
    world.law(joint, lambda t, q, qd: -size * state["z"])
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
"""Effects outside the catalogue by name. `cross_viscosity` and `cable` need two joints."""
