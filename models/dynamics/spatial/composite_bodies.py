"""The inertia matrix by composite rigid bodies: each joint moves all that is further out as one rigid body.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 6. D_jk = S_j · I_composite(k) S_k for j on the way from
k to the world, 0 for joints on different branches.
"""

from invdyn.models.dynamics.spatial.algebra import Vector, add, cross
from invdyn.models.dynamics.spatial.frames import Frame, Frames, RigidBody, joined, moved
from invdyn.models.dynamics.spatial.kinematics import Motion, placed
from invdyn.models.dynamics.traced.expressions import Scalar


def inertia_matrix(frames: Frames, motion: Motion) -> list[list[Scalar]]:
    """D(q), K rows of K; zeros that the tree's branches make are floats."""
    places = placed(frames, motion)
    composite = [frame.body for frame in frames.frames]
    for k in reversed(range(len(composite))):
        if (parent := frames.frames[k].parent) >= 0:
            composite[parent] = joined(composite[parent], moved(composite[k], places[k]))
    D: list[list[Scalar]] = [[0.0] * frames.num_joints for _ in range(frames.num_joints)]
    for k, frame in enumerate(frames.frames):
        moment, force = _column(frame, composite[k])
        for j in frames.ancestors(k):
            other = frames.frames[j]
            value = (moment if other.turns else force)[2]
            D[frame.coordinate][other.coordinate] = D[other.coordinate][frame.coordinate] = value
            if other.parent >= 0:
                force = places[j].inwards(force)
                moment = add(places[j].inwards(moment), cross(places[j].position, force))
    return D


def _column(frame: Frame, body: RigidBody) -> tuple[Vector, Vector]:
    """Moment and force that a unit acceleration of the frame's coordinate needs."""
    mass, h, inertia = body
    if frame.turns:
        return [row[2] for row in inertia], [-h[1], h[0], 0.0]
    return [h[1], -h[0], 0.0], [0.0, 0.0, mass]
