"""Links, loads and motors in other forms. SI units, radians.

backlash      a gear that is slack over its width and springs beyond, with a rotor of its own share of the inertia
bending       a sprung hinge anywhere in the middle fifth of a link, or two of them at its thirds
saturation    hard, or round: u / (1 + |u/u_max|^p)^(1/p)
a push        constant, or as a half wave
"""

from typing import Any

import numpy as np

from invdyn.blindcheck.pieces import Piece
from invdyn.blindcheck.pinocchio.forms import form
from invdyn.blindcheck.pinocchio.simulator import World
from invdyn.blindcheck.scene import Scene, natural_hz

ROTOR_SHAKE_RATE = 2 * np.pi * 60.0
"""rad/s, at which a rotor shakes on its gear's teeth, or more."""


@form()
def armature(world: World, joint: int, inertia: float) -> None:
    """A rotor's inertia, reflected."""
    world.rotors[joint] = world.rotors.get(joint, 0.0) + inertia


@form()
def actuator_gain(world: World, joint: int, gain: float) -> None:
    """(1 + ε) u."""
    world.drive(joint, lambda u, interval, first: (1 + gain) * u)


@form()
def actuator_lag(world: World, joint: int, time_constant: float) -> None:
    """T u̇_f + u_f = u, settled at first."""
    world.lags[joint] = time_constant


@form(lambda rng, s, k, p: p if rng.random() < 0.5 else p | {"sharpness": float(rng.uniform(12.0, 30.0))})
def actuator_saturation(world: World, joint: int, limit: float, sharpness: float | None = None) -> None:
    """No more than ±limit, with a hard or a round corner."""

    def of(u: float, interval: float, first: bool) -> float:
        if sharpness is None:
            return min(max(u, -limit), limit)
        return u / (1 + abs(u / limit) ** sharpness) ** (1 / sharpness)

    world.drive(joint, of)


def _backlash(rng: np.random.Generator, s: Scene, k: int, p: dict) -> dict:
    share = float(rng.uniform(0.35, 0.65))
    rotor = share * s.body.links[k].nominal("inertia")
    stiffness = max(rotor * max(ROTOR_SHAKE_RATE, 30 * natural_hz(s)) ** 2, 20 * s.torque[k] / p["width"])
    damping = 2 * rng.uniform(0.1, 0.4) * np.sqrt(stiffness * rotor)
    return p | {"rotor_share": share, "gear_stiffness": float(stiffness), "gear_damping": float(damping)}


@form(_backlash)
def backlash(
    world: World, joint: int, width: float, rotor_share: float, gear_stiffness: float, gear_damping: float
) -> None:
    """Slack of so much in all between a rotor, with its share of the link's inertia, and the link; teeth only push."""
    link = world.add_rotor(joint, rotor_share)
    link.joint = None

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        s = at[joint] + 1
        side, depth = np.sign(q[s]), abs(q[s]) - width / 2
        if depth > 0:
            tau[s] -= side * max(0.0, gear_stiffness * depth + gear_damping * side * v[s])

    world.force(act)
    world.resolve(lambda mobility: np.sqrt(gear_stiffness * mobility[joint]))


def _bending(rng: np.random.Generator, s: Scene, link: int, p: dict) -> dict:
    if rng.random() < 0.5:
        return p | {"position": float(rng.uniform(0.4, 0.6))}
    # two springs in a row bend a load at the far end about as far as one of half their stiffness in the middle
    return {"each_stiffness": 2 * p["stiffness"], "each_damping": 2 * p["damping"]}


@form(_bending)
def link_flexibility(
    world: World,
    link: int,
    stiffness: float | None = None,
    damping: float = 0.0,
    position: float = 0.5,
    each_stiffness: float = 0.0,
    each_damping: float = 0.0,
) -> None:
    """A link cut in two at a share of its length, or in three, that has its mass, centre and inertia while straight."""
    ends = [0.0, 1 / 3, 2 / 3, 1.0] if stiffness is None else [0.0, position, 1.0]
    k, d = (each_stiffness, each_damping) if stiffness is None else (stiffness, damping)
    pieces = world.cut_link(link, ends)

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        first = world.pieces.index(pieces[1])
        for s in range(first, first + len(pieces) - 1):
            tau[s] -= k * q[s] + d * v[s]

    world.force(act)
    tip = pieces[-1]
    about = tip.inertia[2, 2] + tip.mass * tip.com[0] ** 2
    world.resolve(lambda mobility: 2 * np.sqrt(k / about))


def _wave(rng: np.random.Generator, s: Scene, tip: int, p: dict) -> dict:
    if rng.random() < 0.5:
        return p
    x, y = (np.pi / 2 * p.pop(key) for key in ("force_x", "force_y"))  # of the same impulse
    return p | {"peak_x": x, "peak_y": y}


@form(_wave)
def external_push(
    world: World,
    keypoint: int,
    start: float,
    stop: float,
    force_x: float = 0.0,
    force_y: float = 0.0,
    peak_x: float = 0.0,
    peak_y: float = 0.0,
) -> None:
    """A force at a tip during an interval, constant or half a sine's wave; its mean over each step acts."""
    half_wave = bool(peak_x or peak_y)
    force, now = np.array([peak_x, peak_y, 0.0] if half_wave else [force_x, force_y, 0.0]), [0.0]

    def begin(t: float, h: float, q: np.ndarray, v: np.ndarray, at: list[int]) -> None:
        first, last = max(t, start), min(t + h, stop)
        if last <= first:
            now[0] = 0.0
        elif half_wave:
            ends = np.cos(np.pi * (np.array([first, last]) - start) / (stop - start))
            now[0] = (ends[0] - ends[1]) * (stop - start) / np.pi / h
        else:
            now[0] = (last - first) / h

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        if not now[0]:
            return
        world.pin.forwardKinematics(world.model, world.data, q)
        tip = placed(world.links[keypoint]).act(world.links[keypoint].tip)
        piece: Piece | None = world.links[keypoint]
        while piece is not None:
            own = placed(piece)
            tau[world.pieces.index(piece)] += (
                own.rotation @ piece.axis @ np.cross(tip - own.translation, now[0] * force)
            )
            piece = piece.parent

    def placed(piece: Piece) -> Any:
        return world.data.oMi[1 + world.pieces.index(piece)]

    world.begin(begin)
    world.force(act)


@form()
def base_motion(world: World, amplitude_x: float, amplitude_y: float, frequency: float, phase: float) -> None:
    """The base moves by (a_x, a_y) sin(2π f t + phase): in its frame gravity is g − a_b(t)."""
    amplitude, omega = np.array([amplitude_x, amplitude_y]), 2 * np.pi * frequency
    world.base_shift = lambda t: np.sin(omega * t + phase)[:, None] * amplitude

    def act(t: float, q: np.ndarray, v: np.ndarray, tau: np.ndarray, at: list[int]) -> None:
        gravity = world.gravity.copy()
        gravity[:2] += omega**2 * np.sin(omega * t + phase) * amplitude
        world.model.gravity.linear = gravity

    world.force(act)
    world.resolve(lambda mobility: omega)
