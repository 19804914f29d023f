"""Effects in space: most are those of the plane at a joint or a camera; three act on inertias and gravity in space.

payload          a point mass at the body's tip: the hand's site that lies farthest out
inertial error   mass, centre of mass in the link's frame, and all moments by one factor, their mean by so much
gravity tilt     gravity rotated by a rotation vector about the two level axes
"""

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.blindcheck import effects, unlisted_effects
from invdyn.blindcheck.effects import Injected
from invdyn.blindcheck.in_space.world import Piece, World
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.stretched import stretched

PLANAR_ONLY = (
    "external_push",
    "base_motion",
    "link_flexibility",
    "backlash",
    "keypoint_offset",
    "soft_tissue",
    "camera_scale",
    "camera_roll",
    "camera_yaw",
    "lens_distortion",
    "rolling_shutter",
)
"""Effects that the catalogue knows in the plane alone."""


def _payload(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"mass": a * between(rng, 0.1, 0.5) * stretched(s.body).mass[s.body.hand[0]]}


def payload(world: World, mass: float) -> None:
    """A point mass at the hand's own site."""
    link, site = world.hand
    piece = world.segments[link]
    off = piece.sites[world.keypoint_names[site]] - piece.com
    piece.inertia = piece.inertia + piece.mass * mass / (piece.mass + mass) * _moments(off)
    piece.com = piece.com + mass / (piece.mass + mass) * off
    piece.mass += mass


def _moments(off: np.ndarray) -> np.ndarray:
    """Of one kilogram at a place (3,) about the origin, (3, 3)."""
    return off @ off * np.eye(3) - np.outer(off, off)


def _inertial_error(rng: np.random.Generator, s: Scene, link: int, a: float) -> dict:
    mass, _, inertia = (values[link] for values in stretched(s.body))
    share = a * rng.uniform(0.1, 0.2, 3) * rng.choice([-1.0, 1.0], 3)
    way = rng.normal(size=3)
    size = np.linalg.norm(s.body.parameters().com[link].numpy()) + np.sqrt(inertia / mass)
    com = share[1] * size * way / np.linalg.norm(way)
    return {
        "mass": share[0] * mass,
        **{f"com_{axis}": value for axis, value in zip("xyz", com, strict=True)},
        "inertia": share[2] * inertia,
    }


def inertial_error(
    world: World, link: int, mass: float, com_x: float, com_y: float, com_z: float, inertia: float
) -> None:
    """One link's mass, centre of mass, and the mean of its moments, by so much more than its file says."""
    piece: Piece = world.segments[link]
    piece.mass += mass
    piece.com = piece.com + np.array([com_x, com_y, com_z])
    piece.inertia = piece.inertia * (1 + inertia / (np.trace(piece.inertia) / 3))


def _gravity_tilt(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    angle, heading = a * np.deg2rad(between(rng, 2.0, 12.0)), rng.uniform(0, 2 * np.pi)
    return {"about_x": angle * np.cos(heading), "about_y": angle * np.sin(heading)}


def gravity_tilt(world: World, about_x: float, about_y: float) -> None:
    """Gravity, which points along z, rotated by a rotation vector."""
    world.gravity = Rotation.from_rotvec([about_x, about_y, 0.0]).apply(world.gravity)


_OWN = {
    "payload": Injected("payload", "arm", {"mass": "kg"}, _payload, payload, ()),
    "inertial_error": Injected(
        "inertial_error",
        "link",
        {"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m", "inertia": "kg·m²"},
        _inertial_error,
        inertial_error,
        (),
    ),
    "gravity_tilt": Injected(
        "gravity_tilt", "arm", {"about_x": "rad", "about_y": "rad"}, _gravity_tilt, gravity_tilt, ("gravity",)
    ),
}

EFFECTS = {name: _OWN.get(name, each) for name, each in effects.EFFECTS.items() if name not in PLANAR_ONLY}
"""Those of the catalogue, by name."""

UNLISTED = {name: each for name, each in unlisted_effects.UNLISTED.items() if name != "sloshing_payload"}
"""Those outside of it: all but a weight on a hinge of its own, which would count among the tree's."""
