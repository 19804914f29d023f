"""Inertia and gravity that differ: an inertial in place of the link's own, rotated gravity, a rotor. SI units."""

import numpy as np

from invdyn.blindcheck.effects.effect import mechanism
from invdyn.blindcheck.effects.parts import set_joint
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene, sign
from invdyn.blindcheck.simulator import World


def _payload(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"mass": a * between(rng, 0.1, 0.5) * s.body.links[-1].nominal("mass")}


@mechanism(site="arm", units={"mass": "kg"}, size=_payload)
def payload(world: World, mass: float) -> None:
    """A point mass at the last tip."""
    last = world.segments[-1]
    total = last.mass + mass
    com = (last.mass * last.com + mass * last.length) / total
    last.inertia += last.mass * (last.com - com) ** 2 + mass * (last.length - com) ** 2
    last.mass, last.com = total, com


def _inertial_error(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict:
    mass, length, inertia = (s.body.links[link].nominal(key) for key in ("mass", "length", "inertia"))
    share = a * rng.uniform(0.1, 0.2, 3) * rng.choice([-1.0, 1.0], 3)
    return {"mass": share[0] * mass, "com": share[1] * length / 2, "inertia": share[2] * inertia}


@mechanism(site="link", units={"mass": "kg", "com": "m", "inertia": "kg·m²"}, size=_inertial_error)
def inertial_error(world: World, link: int, mass: float, com: float, inertia: float) -> None:
    """One link's mass, centre of mass along it, and inertia about that, by so much more than its file says."""
    segment = next(s for s in world.segments if s.tip == link)
    segment.mass += mass
    segment.com += com
    segment.inertia += inertia


def _gravity_tilt(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"angle": a * sign(rng) * np.deg2rad(between(rng, 2.0, 12.0))}


@mechanism(site="arm", units={"angle": "rad"}, needs=("gravity",), size=_gravity_tilt)
def gravity_tilt(world: World, angle: float) -> None:
    """Gravity rotated counter-clockwise."""
    x, y, z = world.gravity
    world.gravity = np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z])


def _armature(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    return {"inertia": a * between(rng, 0.1, 0.4) * s.inertia[k]}


@mechanism(units={"inertia": "kg·m²"}, size=_armature)
def armature(world: World, joint: int, inertia: float) -> None:
    """Iₐ θ̈ on the inertia matrix's diagonal."""
    set_joint(world, joint, armature=inertia)
