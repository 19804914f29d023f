"""Inverse dynamics by recursive Newton–Euler, in body axes: torques of a given motion and joints' reactions, O(K).

R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 5. Outwards velocities v and accelerations a, then
forces f = I a + v ×* I v inwards; a torque is what its axis takes of the force that its frame and all further out need.
Gravity is an acceleration −g of the world. Without accelerations, velocities or gravity the recursion is the shorter.
"""

from invdyn.models.dynamics.spatial.algebra import ZERO, Vector, add, apply, cross, scale, subtract
from invdyn.models.dynamics.spatial.frames import Frame, Frames
from invdyn.models.dynamics.spatial.kinematics import Motion, accelerations, placed, velocities, world_frames
from invdyn.models.dynamics.traced.expressions import Scalar


def torques(frames: Frames, motion: Motion) -> list[Scalar]:
    """τ, K entries, of q, q̇ and q̈; q̇ or q̈ may be zeros."""
    found: list[Scalar] = [0.0] * frames.num_joints
    for frame, (moment, force) in zip(frames.frames, _carried(frames, motion), strict=True):
        found[frame.coordinate] = (moment if frame.turns else force)[2]
    return found


def reactions(frames: Frames, motion: Motion) -> list[tuple[Vector, Vector]]:
    """Of each coordinate, in the world's axes: force on what it carries by what it hangs on, moment about its place.

    The frames' bodies must be their own, not regrouped.
    """
    found: list[tuple[Vector, Vector]] = [(ZERO, ZERO)] * frames.num_joints
    carried = zip(frames.frames, world_frames(frames, motion), _carried(frames, motion), strict=True)
    for frame, (axes, _), (moment, force) in carried:
        found[frame.coordinate] = apply(axes, force), apply(axes, moment)
    return found


def _carried(frames: Frames, motion: Motion) -> list[tuple[Vector, Vector]]:
    """Moment and force about each frame's origin, in its axes, that it and all further out need."""
    places, speeds = placed(frames, motion), velocities(frames, motion)
    arrived = accelerations(frames, motion, scale(-1.0, frames.gravity))
    forces = [_force(frame, *of[:2], *at) for frame, of, at in zip(frames.frames, speeds, arrived, strict=True)]
    for k in reversed(range(len(forces))):
        frame, (moment, force) = frames.frames[k], forces[k]
        if frame.parent >= 0:
            force = places[k].inwards(force)
            moment = add(places[k].inwards(moment), cross(places[k].position, force))
            inner = forces[frame.parent]
            forces[frame.parent] = add(inner[0], moment), add(inner[1], force)
    return forces


def _force(frame: Frame, w: Vector, v: Vector, alpha: Vector, a: Vector) -> tuple[Vector, Vector]:
    """Moment and force about a frame's origin that its own body needs: f = m (a + ω×v) + …, written out."""
    m, h = frame.body.mass, frame.body.moment
    linear = add(a, cross(w, v))  # of the origin, seen from the world
    force = add(scale(m, linear), cross(alpha, h), cross(w, cross(w, h)))
    moment = add(apply(frame.body.inertia, alpha), cross(w, apply(frame.body.inertia, w)), cross(h, linear))
    return moment, force


def kinetic_energy(frames: Frames, motion: Motion) -> Scalar:
    """Σ ½ (m v² + 2 h·(v × ω) + ω·I_O ω), J."""
    total: Scalar = 0.0
    for frame, (w, v, _) in zip(frames.frames, velocities(frames, motion), strict=True):
        momentum = subtract(scale(frame.body.mass, v), cross(frame.body.moment, w))
        spin = add(apply(frame.body.inertia, w), cross(frame.body.moment, v))
        for x, y in ((v, momentum), (w, spin)):
            total = total + (x[0] * y[0] + x[1] * y[1] + x[2] * y[2])
    return total * 0.5
