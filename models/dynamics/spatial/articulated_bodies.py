"""Forward dynamics by articulated bodies, in body axes: accelerations of given torques, O(K).

R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7. Spatial vectors are pairs of the angular and the
linear part about a frame's origin; an articulated body's inertia is

    [moment]   [ A   B ] [angular acceleration]
    [force ] = [ Bᵀ  M ] [linear acceleration ]  + bias

Outwards velocities v and bias forces p = v ×* I v; inwards, with S the joint's axis, U = I S and D = S·U + I_own,

    I' = I − U Uᵀ/D      p' = p + I' c + U (τ − S·p)/D

handed to the parent; outwards again q̈ = (τ − S·p − U·a)/D. Gravity is an acceleration −g of the world.
"""

from collections.abc import Sequence
from typing import NamedTuple

from invdyn.models.dynamics.spatial.algebra import (
    ZERO,
    Matrix,
    Vector,
    add,
    apply,
    cross,
    cross_matrix,
    dot,
    matrix_sum,
    multiply,
    scale,
    subtract,
    symmetric,
    transpose,
)
from invdyn.models.dynamics.spatial.frames import Frame, Frames, PlacedFrame
from invdyn.models.dynamics.spatial.kinematics import Motion, placed, velocities
from invdyn.models.dynamics.traced.expressions import Scalar

Pair = tuple[Vector, Vector]


class _Body(NamedTuple):
    """An articulated body: A, B and M as above, and its bias force."""

    A: Matrix
    B: Matrix
    M: Matrix
    moment: Vector
    force: Vector


def accelerations(frames: Frames, motion: Motion, own_inertia: Sequence[Scalar] | None) -> list[Scalar]:
    """q̈, K entries, of q, q̇ and torques; `own_inertia` of the joints' rotors, kg·m², or None."""
    places, speeds = placed(frames, motion), velocities(frames, motion)
    bodies = [_rigid(frame, w, v) for frame, (w, v, _) in zip(frames.frames, speeds, strict=True)]
    solved: list[tuple[Pair, Scalar]] = [((ZERO, ZERO), 0.0)] * len(bodies)
    for k in reversed(range(len(bodies))):
        frame = frames.frames[k]
        has_parent = frame.parent >= 0
        own = 0.0 if own_inertia is None else own_inertia[frame.coordinate]
        solved[k], handed = _released(
            bodies[k], frame.turns, motion.tau[frame.coordinate], own, speeds[k][2], has_parent
        )
        if handed is not None:
            bodies[frame.parent] = _joined(bodies[frame.parent], _moved(handed, places[k]))
    found: list[Scalar] = [0.0] * frames.num_joints
    arrived: list[Pair] = []
    for k, frame in enumerate(frames.frames):
        alpha, a = arrived[frame.parent] if frame.parent >= 0 else (ZERO, scale(-1.0, frames.gravity))
        alpha, a = places[k].outwards(alpha), places[k].outwards(add(a, cross(alpha, places[k].position)))
        (turning, moving), ((angular, linear), rest) = speeds[k][2], solved[k]
        alpha, a = add(alpha, turning), add(a, moving)
        found[frame.coordinate] = qdd = rest - (dot(angular, alpha) + dot(linear, a))
        along = [0.0, 0.0, qdd]
        arrived.append((add(alpha, along), a) if frame.turns else (alpha, add(a, along)))
    return found


def _rigid(frame: Frame, w: Vector, v: Vector) -> _Body:
    m, h = frame.body.mass, frame.body.moment
    momentum = subtract(scale(m, v), cross(h, w))
    spin = add(apply(frame.body.inertia, w), cross(h, v))
    M = symmetric(lambda i, j: m if i == j else 0.0)
    return _Body(frame.body.inertia, cross_matrix(h), M, add(cross(w, spin), cross(v, momentum)), cross(w, momentum))


def _released(
    body: _Body, turns: bool, tau: Scalar, own: Scalar, velocity_product: Pair, has_parent: bool
) -> tuple[tuple[Pair, Scalar], _Body | None]:
    """U/D and (τ − S·p)/D of a body, and what it hands to the parent, in its own axes."""
    A, B, M, moment, force = body
    angular = [row[2] for row in A] if turns else [row[2] for row in B]
    linear = list(B[2]) if turns else [row[2] for row in M]
    inverse = 1.0 / ((angular if turns else linear)[2] + own)
    k, l = list(scale(inverse, angular)), list(scale(inverse, linear))
    if isinstance(own, float) and own == 0:  # then the body gives no resistance along its axis: exact zeros
        (k if turns else l)[2] = 1.0
    rest = (tau - (moment if turns else force)[2]) * inverse
    if not has_parent:
        return ((k, l), rest), None
    left_A = symmetric(lambda i, j: A[i][j] - angular[i] * k[j])
    left_B = [[B[i][j] - (k[i] * linear[j] if turns else angular[i] * l[j]) for j in range(3)] for i in range(3)]
    left_M = symmetric(lambda i, j: M[i][j] - linear[i] * l[j])
    turning, moving = velocity_product
    moment = add(moment, apply(left_A, turning), apply(left_B, moving), scale(rest, angular))
    force = add(force, apply(transpose(left_B), turning), apply(left_M, moving), scale(rest, linear))
    return ((k, l), rest), _Body(left_A, left_B, left_M, moment, force)


def _moved(body: _Body, place: PlacedFrame) -> _Body:
    """The same in the parent's axes, about its origin."""
    A, B, M = (place.matrix_inwards(body.A, True), place.matrix_inwards(body.B), place.matrix_inwards(body.M, True))
    force = place.inwards(body.force)
    moment = add(place.inwards(body.moment), cross(place.position, force))
    lever = cross_matrix(place.position)
    rotated_B = matrix_sum(B, multiply(lever, M))
    lever_B, B_lever = multiply(lever, transpose(B)), multiply(rotated_B, transpose(lever))
    whole_A = symmetric(lambda i, j: A[i][j] + (lever_B[i][j] + B_lever[i][j]))
    return _Body(whole_A, rotated_B, M, moment, force)


def _joined(one: _Body, other: _Body) -> _Body:
    A = symmetric(lambda i, j: one.A[i][j] + other.A[i][j])
    M = symmetric(lambda i, j: one.M[i][j] + other.M[i][j])
    B = matrix_sum(one.B, other.B)
    return _Body(A, B, M, add(one.moment, other.moment), add(one.force, other.force))
