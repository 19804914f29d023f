"""Forces and motions from elsewhere, and parts that bend or wear.

base motion        the frame of the base accelerates: gravity g − a_b(t), and all points move
link flexibility   the link cut at half its length, a sprung hinge between the halves
drifting friction  dof_damping rewritten every step
"""

from typing import Any

import numpy as np

from invdyn.blindcheck.effects.effect import mechanism, set_joint
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene, natural_hz
from invdyn.blindcheck.simulator import World, set_part


def _torque_ripple(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    return {
        "amplitude": a * rng.uniform(0.02, 0.06) * s.peak[k],
        "periods": rng.choice([4, 5, 6, 8, 10, 12]),
        "phase": rng.uniform(0, 2 * np.pi),
    }


@mechanism(units={"amplitude": "N·m", "periods": "1", "phase": "rad"}, size=_torque_ripple)
def torque_ripple(world: World, joint: int, amplitude: float, periods: float, phase: float) -> None:
    """A sin(N θ + φ)."""
    world.law(joint, lambda t, q, qd: amplitude * np.sin(periods * q[joint] + phase))


def _external_push(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    lever = sum(link.nominal("length") for link in s.body.links[: k + 1])
    force = a * between(rng, 1.0, 4.0) * max(s.torque[0], s.inertia[0] * s.speed[0] * 2 * np.pi * natural_hz(s)) / lever
    angle, start = rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.75) * s.plan.duration
    last = between(rng, 0.02, 0.2) * min(1.0, 1 / natural_hz(s))
    return {
        "force_x": force * np.cos(angle),
        "force_y": force * np.sin(angle),
        "start": start,
        "stop": start + max(last, 2 / s.plan.frame_rate),
    }


@mechanism(site="keypoint", units={"force_x": "N", "force_y": "N", "start": "s", "stop": "s"}, size=_external_push)
def external_push(world: World, keypoint: int, force_x: float, force_y: float, start: float, stop: float) -> None:
    """A constant force at a tip during an interval, as `xfrc_applied` at the centre of mass and a torque about it."""

    def act(t: float, model: Any, data: Any) -> None:
        link = world.links[keypoint]
        body = 1 + world.pieces.index(link)
        # the share of this step that lies within the interval
        step = model.opt.timestep
        share = np.clip((min(stop, t + step) - max(start, t)) / step, 0.0, 1.0)
        # kinematics of this very state: those in data are of the last step's beginning
        heading = np.cumsum(data.qpos)[body - 1]
        arm = (link.tip - link.com)[0] * np.array([np.cos(heading), np.sin(heading)])
        torque = arm[0] * force_y - arm[1] * force_x
        data.xfrc_applied[body] = share * np.array([force_x, force_y, 0.0, 0.0, 0.0, torque])

    world.on_step(act)


def _base_motion(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    angle, size = rng.uniform(0, 2 * np.pi), a * between(rng, 0.01, 0.03) * s.reach
    return {
        "amplitude_x": size * np.cos(angle),
        "amplitude_y": size * np.sin(angle),
        "frequency": natural_hz(s) * between(rng, 0.7, 3.0),
        "phase": rng.uniform(0, 2 * np.pi),
    }


@mechanism(
    site="arm", units={"amplitude_x": "m", "amplitude_y": "m", "frequency": "Hz", "phase": "rad"}, size=_base_motion
)
def base_motion(world: World, amplitude_x: float, amplitude_y: float, frequency: float, phase: float) -> None:
    """The base moves by (a_x, a_y) sin(2π f t + φ)."""
    amplitude, omega = np.array([amplitude_x, amplitude_y]), 2 * np.pi * frequency
    world.base_shift = lambda t: np.sin(omega * t + phase)[:, None] * amplitude

    def act(t: float, model: Any, data: Any) -> None:
        middle = t + model.opt.timestep / 2
        model.opt.gravity[:2] = world.gravity[:2] + omega**2 * amplitude * np.sin(omega * middle + phase)

    world.on_step(act)


def _link_flexibility(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict:
    # inertia beyond the middle of the link, outstretched; weak is stiffer: the bend is proportional to 1/k
    far, inertia = -s.body.links[link].nominal("length") / 2, 0.0
    for n, each in enumerate(s.body.links[link:]):
        share = 0.5 if n == 0 else 1.0
        at = far + (0.75 * each.nominal("length") if n == 0 else each.nominal("com"))
        inertia += share * (each.nominal("mass") * at**2 + each.nominal("inertia") * (0.25 if n == 0 else 1.0))
        far += each.nominal("length")
    frequency = np.clip(natural_hz(s) * between(rng, 5.0, 10.0), 5.0, 30.0)
    stiffness = inertia * (2 * np.pi * frequency) ** 2
    return {"stiffness": stiffness / a, "damping": 2 * rng.uniform(0.03, 0.15) * np.sqrt(stiffness / a * inertia)}


@mechanism(site="link", units={"stiffness": "N·m/rad", "damping": "N·m·s/rad"}, size=_link_flexibility)
def link_flexibility(world: World, link: int, stiffness: float, damping: float) -> None:
    """The link in two halves that together have its mass, centre and inertia, a sprung hinge at half its length."""
    _, outer = world.cut_link(link, (0.0, 0.5, 1.0))
    world.on_spec(lambda spec: set_part(spec.joint(outer.hinge), {"stiffness": stiffness, "damping": damping}))


def _drifting_friction(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    b = a * between(rng, 0.03, 0.1) * s.torque[k] / s.speed[k]
    return {"damping": b, "slope": b * rng.uniform(1.5, 4.0) / s.plan.duration}


@mechanism(units={"damping": "N·m·s/rad", "slope": "N·m/rad"}, size=_drifting_friction)
def drifting_friction(world: World, joint: int, damping: float, slope: float) -> None:
    """−(b₀ + slope t) θ̇, never below 0."""
    set_joint(world, joint, damping=damping)

    def act(t: float, model: Any, data: Any) -> None:
        model.dof_damping[world.hinge(joint)] = max(damping + slope * t, 0.0)

    world.on_step(act)
