"""How large an effect is: drawn around the typical values of the catalogue, scaled to a body and its motion.

A joint's yardsticks are the root mean square of its torque τ and of its velocity ω in the motion without the
effect; a mouse's limb and an industrial arm then meet the same share of friction. `strength` 1 is typical, 0.25 weak:
what the effect does to the recording grows in proportion, at least to begin with.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from invdyn.blindcheck.motion import Plan, between, pendulum_frequency
from invdyn.blindcheck.simulator import Trajectory, World
from invdyn.models import Body

UNITS = {
    "viscous_friction": {"damping": "N·m·s/rad"},
    "coulomb_friction": {"torque": "N·m"},
    "stribeck_friction": {
        "coulomb": "N·m",
        "static": "N·m",
        "velocity": "rad/s",
        "bristle_stiffness": "N·m/rad",
        "bristle_damping": "N·m·s/rad",
    },
    "load_friction": {"coefficient": "1"},
    "quadratic_drag": {"drag": "N·m·s²/rad²"},
    "joint_stiffness": {"stiffness": "N·m/rad", "rest_angle": "rad"},
    "joint_coupling": {"stiffness": "N·m/rad", "ratio": "1"},
    "joint_limit": {"angle": "rad", "stiffness": "N·m/rad", "damping": "N·m·s/rad", "side": "1"},
    "payload": {"mass": "kg"},
    "inertial_error": {"mass": "kg", "com": "m", "inertia": "kg·m²"},
    "gravity_tilt": {"angle": "rad"},
    "armature": {"inertia": "kg·m²"},
    "actuator_gain": {"gain": "1"},
    "actuator_delay": {"delay": "s"},
    "actuator_lag": {"time_constant": "s"},
    "actuator_saturation": {"limit": "N·m"},
    "actuator_deadzone": {"width": "N·m"},
    "backlash": {"width": "rad"},
    "torque_ripple": {"amplitude": "N·m", "periods": "1", "phase": "rad"},
    "external_push": {"force_x": "N", "force_y": "N", "start": "s", "stop": "s"},
    "base_motion": {"amplitude_x": "m", "amplitude_y": "m", "frequency": "Hz", "phase": "rad"},
    "link_flexibility": {"stiffness": "N·m/rad", "damping": "N·m·s/rad"},
    "drifting_friction": {"damping": "N·m·s/rad", "slope": "N·m/rad"},
    "keypoint_offset": {"along": "m", "across": "m"},
    "soft_tissue": {"kappa": "s²", "damping_ratio": "1"},
    "camera_scale": {"scale": "1"},
    "camera_roll": {"angle": "rad"},
    "camera_yaw": {"angle": "rad", "distance": "m", "centre_x": "m", "centre_y": "m"},
    "lens_distortion": {"k1": "m⁻²", "centre_x": "m", "centre_y": "m"},
    "clock_rate": {"rate": "1"},
    "camera_latency": {"latency": "s"},
    "rolling_shutter": {"readout": "s/m"},
    "timestamp_jitter": {"rate": "1", "sd": "s"},
    "outliers": {"rate": "1", "scale": "m"},
    "label_swap": {"rate": "1"},
    "varying_noise": {"slope": "s/m"},
}
"""Unit of every parameter of every effect; "1" where it has none. Softer forms have the last ones besides."""

SOFTER = 0.4
"""Share of friction, tissue and lenses that are not ideal."""


@dataclass(frozen=True)
class Scene:
    """A body, its motion without the effect, and the yardsticks that follow; (K,) by joint.

    `torque`, `peak`: rms and largest torque, N·m; `speed` rad/s; `inertia` kg·m² of the joint with what it carries.
    """

    body: Body
    plan: Plan
    motion: Trajectory
    torque: np.ndarray
    peak: np.ndarray
    speed: np.ndarray
    inertia: np.ndarray

    @property
    def reach(self) -> float:
        """Length of the outstretched body, m."""
        return sum(link.nominal("length") for link in self.body.links)


def scene(body: Body, plan: Plan, motion: Trajectory) -> Scene:
    """The yardsticks of a motion; a passive one's torque is the load of gravity."""
    some = slice(None, None, max(1, len(motion.time) // 500))
    still = np.zeros_like(motion.q[some])
    torque = World(body).inverse(motion.q[some], still, still) if plan.passive else motion.command
    return Scene(
        body=body,
        plan=plan,
        motion=motion,
        torque=np.sqrt((torque**2).mean(axis=0)),
        peak=np.abs(torque).max(axis=0),
        speed=np.sqrt((motion.qd**2).mean(axis=0)),
        inertia=World(body).inertia(plan.centre).diagonal(),
    )


def draw(effect: str, rng: np.random.Generator, s: Scene, place: int | None, strength: float = 1.0) -> dict[str, float]:
    """Parameters of an effect at a joint, link or keypoint (counted from 0; None for those of the whole)."""
    return {name: float(value) for name, value in SIZES[effect](rng, s, place, strength).items()}


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _stribeck(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    coulomb = a * between(rng, 0.03, 0.1) * s.torque[k]
    static = coulomb * rng.uniform(1.5, 3.0)
    level = {"coulomb": coulomb, "static": static, "velocity": rng.uniform(0.2, 0.6) * s.speed[k]}
    if rng.random() > SOFTER:
        return level
    stiffness = static / between(rng, 3e-4, 3e-3)  # bent by so many radians it slips
    damping = 2 * rng.uniform(0.3, 0.8) * np.sqrt(stiffness * s.inertia[k])
    return level | {"bristle_stiffness": stiffness, "bristle_damping": damping}


def _limit(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    side = _sign(rng)
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


def _inertial(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict[str, float]:
    mass, length, inertia = (s.body.links[link].nominal(key) for key in ("mass", "length", "inertia"))
    share = a * rng.uniform(0.1, 0.2, 3) * rng.choice([-1.0, 1.0], 3)
    return {"mass": share[0] * mass, "com": share[1] * length / 2, "inertia": share[2] * inertia}


def _saturation(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    u = np.abs(s.motion.command[:, k])
    return {"limit": s.peak[k] - a * (s.peak[k] - np.quantile(u, rng.uniform(0.6, 0.85)))}


def _push(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    lever = sum(link.nominal("length") for link in s.body.links[: k + 1])
    force = a * between(rng, 1.0, 4.0) * max(s.torque[0], s.inertia[0] * s.speed[0] * 2 * np.pi * _hz(s)) / lever
    angle, start = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.75) * s.plan.duration
    last = between(rng, 0.02, 0.2) * min(1.0, 1 / _hz(s))
    return {
        "force_x": force * np.cos(angle),
        "force_y": force * np.sin(angle),
        "start": start,
        "stop": start + max(last, 2 / s.plan.frame_rate),
    }


def _base(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict[str, float]:
    angle, size = rng.uniform(0, 2 * np.pi), a * between(rng, 0.01, 0.03) * s.reach
    return {
        "amplitude_x": size * np.cos(angle),
        "amplitude_y": size * np.sin(angle),
        "frequency": _hz(s) * between(rng, 0.7, 3.0),
        "phase": rng.uniform(0, 2 * np.pi),
    }


def _flexibility(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict[str, float]:
    # inertia beyond the middle of the link, outstretched; weak is stiffer: the bend goes with 1/k
    far, inertia = -s.body.links[link].nominal("length") / 2, 0.0
    for n, each in enumerate(s.body.links[link:]):
        share = 0.5 if n == 0 else 1.0
        at = far + (0.75 * each.nominal("length") if n == 0 else each.nominal("com"))
        inertia += share * (each.nominal("mass") * at**2 + each.nominal("inertia") * (0.25 if n == 0 else 1.0))
        far += each.nominal("length")
    frequency = np.clip(_hz(s) * between(rng, 5.0, 10.0), 5.0, 30.0)
    stiffness = inertia * (2 * np.pi * frequency) ** 2
    return {"stiffness": stiffness / a, "damping": 2 * rng.uniform(0.03, 0.15) * np.sqrt(stiffness / a * inertia)}


def _drift(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    b = a * between(rng, 0.03, 0.1) * s.torque[k] / s.speed[k]
    return {"damping": b, "slope": b * rng.uniform(1.5, 4.0) / s.plan.duration}


def _offset(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    angle, size = rng.uniform(0, 2 * np.pi), a * rng.uniform(0.03, 0.1) * s.body.links[k].nominal("length")
    return {"along": size * np.cos(angle), "across": size * np.sin(angle)}


def _tissue(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict[str, float]:
    second = np.gradient(np.gradient(s.motion.points[:, k + 1], s.motion.time, axis=0), s.motion.time, axis=0)
    rms = np.sqrt((second**2).sum(-1).mean())
    kappa = a * rng.uniform(0.02, 0.05) * s.body.links[k].nominal("length") / rms
    return {"kappa": kappa} | ({"damping_ratio": rng.uniform(0.1, 0.6)} if rng.random() < SOFTER else {})


def _hz(s: Scene) -> float:
    return pendulum_frequency(s.body)


def _yaw(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict[str, float]:
    turned = {"angle": a * _sign(rng) * np.deg2rad(rng.uniform(4, 12)), "distance": rng.uniform(2.0, 5.0) * s.reach}
    return turned | _centre(rng, s)


def _lens(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict[str, float]:
    return {"k1": a * _sign(rng) * rng.uniform(0.02, 0.08) / s.reach**2} | _centre(rng, s)


def _centre(rng: np.random.Generator, s: Scene) -> dict[str, float]:
    """Where the camera looks, if not at the origin: of an arm with one link, that would make another twin of it."""
    if s.body.num_joints == 1 or rng.random() > SOFTER:
        return {}
    return {f"centre_{axis}": rng.uniform(-0.4, 0.4) * s.reach for axis in "xy"}


SIZES: dict[str, Callable[..., dict[str, float]]] = {
    "viscous_friction": lambda rng, s, k, a: {"damping": a * between(rng, 0.04, 0.2) * s.torque[k] / s.speed[k]},
    "coulomb_friction": lambda rng, s, k, a: {"torque": a * between(rng, 0.04, 0.15) * s.torque[k]},
    "stribeck_friction": _stribeck,
    "load_friction": lambda rng, s, k, a: {"coefficient": a * rng.uniform(0.08, 0.3)},
    "quadratic_drag": lambda rng, s, k, a: {"drag": a * between(rng, 0.03, 0.12) * s.torque[k] / s.speed[k] ** 2},
    "joint_stiffness": lambda rng, s, k, a: {
        "stiffness": a * between(rng, 0.1, 0.5) * s.torque[k],
        "rest_angle": s.plan.centre[k] + rng.uniform(-0.8, 0.8),
    },
    "joint_coupling": lambda rng, s, k, a: {
        "stiffness": a * between(rng, 0.1, 0.4) * s.torque[k],
        "ratio": _sign(rng) * rng.uniform(0.4, 1.2),
    },
    "joint_limit": _limit,
    "payload": lambda rng, s, place, a: {"mass": a * between(rng, 0.1, 0.5) * s.body.links[-1].nominal("mass")},
    "inertial_error": _inertial,
    "gravity_tilt": lambda rng, s, place, a: {"angle": a * _sign(rng) * np.deg2rad(between(rng, 2.0, 12.0))},
    "armature": lambda rng, s, k, a: {"inertia": a * between(rng, 0.1, 0.4) * s.inertia[k]},
    "actuator_gain": lambda rng, s, k, a: {"gain": a * _sign(rng) * rng.uniform(0.1, 0.25)},
    "actuator_delay": lambda rng, s, k, a: {"delay": a * np.clip(rng.uniform(0.01, 0.05) / _hz(s), 0.005, 0.05)},
    "actuator_lag": lambda rng, s, k, a: {"time_constant": a * np.clip(rng.uniform(0.01, 0.05) / _hz(s), 0.005, 0.05)},
    "actuator_saturation": _saturation,
    "actuator_deadzone": lambda rng, s, k, a: {"width": a * rng.uniform(0.02, 0.06) * s.peak[k]},
    "backlash": lambda rng, s, k, a: {"width": a * np.deg2rad(between(rng, 0.5, 2.0))},
    "torque_ripple": lambda rng, s, k, a: {
        "amplitude": a * rng.uniform(0.02, 0.06) * s.peak[k],
        "periods": rng.choice([4, 5, 6, 8, 10, 12]),
        "phase": rng.uniform(0, 2 * np.pi),
    },
    "external_push": _push,
    "base_motion": _base,
    "link_flexibility": _flexibility,
    "drifting_friction": _drift,
    "keypoint_offset": _offset,
    "soft_tissue": _tissue,
    "camera_scale": lambda rng, s, place, a: {"scale": 1 + a * _sign(rng) * rng.uniform(0.02, 0.08)},
    "camera_roll": lambda rng, s, place, a: {"angle": a * _sign(rng) * np.deg2rad(rng.uniform(1.0, 3.0))},
    "camera_yaw": _yaw,
    "lens_distortion": _lens,
    "clock_rate": lambda rng, s, place, a: {"rate": np.exp(a * _sign(rng) * rng.uniform(0.05, 0.22))},
    "camera_latency": lambda rng, s, place, a: {"latency": a * np.clip(rng.uniform(0.01, 0.06) / _hz(s), 0.005, 0.06)},
    "rolling_shutter": lambda rng, s, place, a: {
        "readout": a * _sign(rng) * np.clip(rng.uniform(0.01, 0.03) / _hz(s), 0.003, 0.03) / s.reach
    },
    "timestamp_jitter": lambda rng, s, place, a: {
        "rate": rng.uniform(0.3, 1.0),
        "sd": a * rng.uniform(0.5, 1.0) * max(1 / s.plan.frame_rate, 0.01 / _hz(s)),
    },
    "outliers": lambda rng, s, place, a: {
        "rate": a * between(rng, 0.01, 0.1),
        "scale": rng.uniform(0.1, 0.4) * s.reach,
    },
    "label_swap": lambda rng, s, place, a: {"rate": a * between(rng, 0.01, 0.05)},
    "varying_noise": lambda rng, s, place, a: {
        "slope": a
        * rng.uniform(2.0, 6.0)
        / np.sqrt((np.gradient(s.motion.points[:, -1], s.motion.time, axis=0) ** 2).sum(-1).mean())
    },
}
"""Draw of each effect's parameters: (generator, scene, place, strength) → name → value."""
