"""What moves a tree: each coordinate's value, velocity, acceleration and torque; and velocities of all frames."""

from collections.abc import Sequence
from typing import NamedTuple

from invdyn.models.dynamics.spatial.algebra import ZERO, Vector, add, cross
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
