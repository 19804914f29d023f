"""What moves a tree and where things then are: velocities of all frames, sites, their Jacobian, and potential energy.

∂x/∂q_j = z_j × (x − p_j) for a turn about z_j through p_j, z_j for a shift; 0 for joints that do not carry the site
"""

from collections.abc import Sequence
from typing import NamedTuple

from invdyn.models.dynamics.spatial.algebra import UNIT, ZERO, Matrix, Vector, add, apply, cross, dot, subtract
from invdyn.models.dynamics.spatial.frames import Frames, PlacedFrame
from invdyn.models.dynamics.traced.expressions import Scalar

NONE: Sequence[Scalar] = ()


class Motion(NamedTuple):
    """Entries by coordinate."""

    q: Sequence[Scalar]
    cos: Sequence[Scalar]
    sin: Sequence[Scalar]
    qd: Sequence[Scalar] = NONE
    qdd: Sequence[Scalar] = NONE
    tau: Sequence[Scalar] = NONE


def placed(frames: Frames, motion: Motion) -> list[PlacedFrame]:
    """All frames at the values of their coordinates."""
    return [
        frame.at(motion.q[frame.coordinate], motion.cos[frame.coordinate], motion.sin[frame.coordinate])
        for frame in frames.frames
    ]


def velocities(frames: Frames, motion: Motion) -> list[tuple[Vector, Vector, tuple[Vector, Vector]]]:
    """Of each frame, in its axes: angular velocity, velocity of its origin, and the pair v × S q̇, angular first."""
    found: list[tuple[Vector, Vector, tuple[Vector, Vector]]] = []
    for frame, place in zip(frames.frames, placed(frames, motion), strict=True):
        w, v = found[frame.parent][:2] if frame.parent >= 0 else (ZERO, ZERO)
        w, v = place.outwards(w), place.outwards(add(v, cross(w, place.position)))
        along = [0.0, 0.0, motion.qd[frame.coordinate]]
        if frame.turns:
            found.append((add(w, along), v, (cross(w, along), cross(v, along))))
        else:
            found.append((w, add(v, along), (ZERO, cross(w, along))))
    return found


def accelerations(frames: Frames, motion: Motion, world: Vector = ZERO) -> list[tuple[Vector, Vector]]:
    """Of each frame, in its axes: the change of its pair of velocities, where that of the ``world`` is so much.

    The second is of what passes the origin: ω × v more is the origin's own acceleration, m/s².
    """
    found: list[tuple[Vector, Vector]] = []
    places, speeds = placed(frames, motion), velocities(frames, motion)
    for frame, place, (_, _, (turning, moving)) in zip(frames.frames, places, speeds, strict=True):
        alpha, a = found[frame.parent] if frame.parent >= 0 else (ZERO, world)
        alpha, a = place.outwards(alpha), place.outwards(add(a, cross(alpha, place.position)))
        along = [0.0, 0.0, motion.qdd[frame.coordinate]]
        alpha, a = add(alpha, turning), add(a, moving)
        found.append((add(alpha, along), a) if frame.turns else (alpha, add(a, along)))
    return found


def world_frames(frames: Frames, motion: Motion) -> list[tuple[Matrix, Vector]]:
    """Of each frame: its axes as the columns of a matrix, and its origin, m."""
    found: list[tuple[Matrix, Vector]] = []
    for frame, place in zip(frames.frames, placed(frames, motion), strict=True):
        axes, origin = found[frame.parent] if frame.parent >= 0 else (UNIT, ZERO)
        # rows of the world's axes as seen in the frame: R = R_parent R_local
        own = [place.outwards(row) for row in axes]
        found.append((own, add(origin, apply(axes, place.position))))
    return found


def sites(frames: Frames, motion: Motion) -> list[Vector]:
    """Positions of all sites, m."""
    world = world_frames(frames, motion)
    found = []
    for at, offset in frames.sites:
        axes, origin = world[at] if at >= 0 else (UNIT, ZERO)
        found.append(add(origin, apply(axes, offset)))
    return found


def site_accelerations(frames: Frames, motion: Motion) -> list[Vector]:
    """r̈ = v̇ + ω × v + ω̇ × r + ω × (ω × r) of all sites, m/s², in the world's axes."""
    world, speeds, changes = world_frames(frames, motion), velocities(frames, motion), accelerations(frames, motion)
    found = []
    for at, r in frames.sites:
        if at < 0:
            found.append(ZERO)
            continue
        (w, v, _), (alpha, a) = speeds[at], changes[at]
        found.append(apply(world[at][0], add(a, cross(w, v), cross(alpha, r), cross(w, cross(w, r)))))
    return found


def jacobian(frames: Frames, motion: Motion) -> list[list[Vector]]:
    """Of each site: ∂x/∂q, for each of x, y and z its K entries."""
    world = world_frames(frames, motion)
    found: list[list[Vector]] = []
    for (at, _), x in zip(frames.sites, sites(frames, motion), strict=True):
        columns: list[Vector] = [ZERO] * frames.num_joints
        for k in frames.ancestors(at):
            frame = frames.frames[k]
            axis = [row[2] for row in world[k][0]]
            columns[frame.coordinate] = cross(axis, subtract(x, world[k][1])) if frame.turns else axis
        found.append([list(row) for row in zip(*columns, strict=True)])
    return found


def potential_energy(frames: Frames, motion: Motion) -> Scalar:
    """V = −Σ g·(m p + R h), J, zero at the world's origin; of all that moves."""
    total: Scalar = 0.0
    for frame, (axes, origin) in zip(frames.frames, world_frames(frames, motion), strict=True):
        weight = [frame.body.mass * x + y for x, y in zip(origin, apply(axes, frame.body.moment), strict=True)]
        total = total - dot(frames.gravity, weight)
    return total
