"""Inertia and gravity that differ: an inertial in place of the link's own, rotated gravity, a rotor. SI units.

payload          a point mass at the body's tip: the hand's site that lies farthest out
inertial error   mass, centre of mass along a link in the plane and in the link's frame in space, and all moments by one
                 factor, their mean by so much
gravity tilt     gravity rotated counter-clockwise in the plane, in space by a rotation vector about the two level axes
"""

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.blindcheck.effects.effect import mechanism, set_joint
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene, sign
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.stretched import stretched


@mechanism(
    site="arm",
    units={"mass": "kg"},
    size=lambda rng, s, place, a: {"mass": a * between(rng, 0.1, 0.5) * stretched(s.body).mass[s.body.hand[0]]},
)
def payload(world: World, mass: float) -> None:
    """A point mass at the hand's own site."""
    link, site = world.hand
    piece = world.links[link]
    off = piece.sites[world.keypoint_names[site]] - piece.com
    moments = off @ off * np.eye(3) - np.outer(off, off)  # of one kilogram
    piece.inertia = piece.inertia + piece.mass * mass / (piece.mass + mass) * moments
    piece.com = piece.com + mass / (piece.mass + mass) * off
    piece.mass += mass


def _inertial_error(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict:
    mass, _, inertia = (values[link] for values in stretched(s.body))
    share = a * rng.uniform(0.1, 0.2, 3) * rng.choice([-1.0, 1.0], 3)
    found = {"mass": share[0] * mass, "inertia": share[2] * inertia}
    if s.body.is_chain:
        return found | {"com": share[1] * s.body.links[link].nominal("length") / 2}
    way = rng.normal(size=3)
    size = np.linalg.norm(s.body.parameters().com[link].numpy()) + np.sqrt(inertia / mass)
    com = share[1] * size * way / np.linalg.norm(way)
    return found | {f"com_{axis}": value for axis, value in zip("xyz", com, strict=True)}


@mechanism(site="link", units={"mass": "kg", "com": "m", "inertia": "kg·m²"}, size=_inertial_error)
def inertial_error(
    world: World,
    link: int,
    mass: float,
    inertia: float,
    com: float = 0.0,
    com_x: float = 0.0,
    com_y: float = 0.0,
    com_z: float = 0.0,
) -> None:
    """One link's mass, centre of mass, and the mean of its moments, by so much more than its file says."""
    piece = world.links[link]
    piece.mass += mass
    piece.com = piece.com + np.array([com + com_x, com_y, com_z])
    piece.inertia = piece.inertia * (1 + inertia / (np.trace(piece.inertia) / 3))


def _gravity_tilt(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    if s.body.is_chain:
        return {"angle": a * sign(rng) * np.deg2rad(between(rng, 2.0, 12.0))}
    angle, heading = a * np.deg2rad(between(rng, 2.0, 12.0)), rng.uniform(0, 2 * np.pi)
    return {"about_x": angle * np.cos(heading), "about_y": angle * np.sin(heading)}


@mechanism(site="arm", units={"angle": "rad"}, needs=("gravity",), size=_gravity_tilt)
def gravity_tilt(world: World, angle: float = 0.0, about_x: float = 0.0, about_y: float = 0.0) -> None:
    """Gravity rotated by a rotation vector."""
    world.gravity = Rotation.from_rotvec([about_x, about_y, angle]).apply(world.gravity)


@mechanism(units={"inertia": "kg·m²"}, size=lambda rng, s, k, a: {"inertia": a * between(rng, 0.1, 0.4) * s.inertia[k]})
def armature(world: World, joint: int, inertia: float) -> None:
    """Iₐ θ̈ on the inertia matrix's diagonal."""
    set_joint(world, joint, armature=inertia)
