"""A tree as elementary frames: each hangs on another by one turn about, or one shift along, its own z axis.

A frame is placed in its parent frame by a constant rotation R₀ and position p₀; its coordinate then turns it,
v_parent = R₀ Rz(q) v, or shifts it, p = p₀ + q R₀ z. Joints of several coordinates become frames in a row, of which the
last one carries the link; axes other than z go into R₀. Links on fixed joints are lumped with what carries them, links
that the world carries are left out. All constants may be expressions of a body's numbers.

A rigid body's inertia about its frame's origin: mass m kg, first moment h = m·com kg·m, and the tensor
I_O = I + m (com² 1 − com comᵀ) kg·m².

Of each body, what its coordinate cannot move belongs to the parent as well: of a turn about z a thin rod on that axis,
with all of m, h_z and I_yy; of a shift the tensor. Regrouped so, from the outermost body inwards, they are zeros that
shorten every recursion, and no torque or acceleration is another: W. Khalil and J.-F. Kleinfinger, "Minimum operations
and minimum parameters of the dynamic models of tree structure robots", IEEE J. Robotics and Automation 3 (1987).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

from invdyn.models.bodies.body import Body
from invdyn.models.bodies.inertia import PLACES
from invdyn.models.bodies.rotations import onto
from invdyn.models.dynamics.spatial.algebra import (
    NOTHING,
    UNIT,
    ZERO,
    Matrix,
    Vector,
    add,
    apply,
    conjugate,
    dot,
    multiply,
    scale,
    symmetric,
    transpose,
)
from invdyn.models.dynamics.traced.expressions import Scalar

Entry = Callable[..., Scalar]
"""Of a field of `TreeParameters` and the place in it: the scalar there."""


class RigidBody(NamedTuple):
    """Inertia about a frame's origin: m, h and I_O as above."""

    mass: Scalar = 0.0
    moment: Vector = ZERO
    inertia: Matrix = NOTHING


@dataclass
class Frame:
    """One frame, with the inertia of all that moves with it; `parent` −1 is the world, `coordinate` counts from 0."""

    parent: int
    rotation: Matrix
    position: Vector
    turns: bool
    coordinate: int
    body: RigidBody = field(default_factory=RigidBody)

    def at(self, q: Scalar, cos: Scalar, sin: Scalar) -> "PlacedFrame":
        """The frame at a value of its coordinate, of which q serves a shift, its cosine and sine a turn."""
        return PlacedFrame(self, q, cos, sin)


class PlacedFrame:
    """A frame at one value of its coordinate: changes of axes from it to its parent's, and back."""

    def __init__(self, frame: Frame, q: Scalar, cos: Scalar, sin: Scalar):
        self.frame, self.cos, self.sin = frame, cos, sin
        along = [row[2] for row in frame.rotation]
        self.position = frame.position if frame.turns else add(frame.position, scale(q, along))

    def inwards(self, v: Vector) -> Vector:
        """A vector of this frame's axes in its parent's."""
        if self.frame.turns:
            v = [self.cos * v[0] - self.sin * v[1], self.sin * v[0] + self.cos * v[1], v[2]]
        return apply(self.frame.rotation, v)

    def outwards(self, v: Vector) -> Vector:
        """A vector of the parent's axes in this frame's."""
        v = apply(transpose(self.frame.rotation), v)
        if self.frame.turns:
            v = [self.cos * v[0] + self.sin * v[1], self.cos * v[1] - self.sin * v[0], v[2]]
        return v

    def matrix_inwards(self, m: Matrix, is_symmetric: bool = False) -> Matrix:
        """A matrix of this frame's axes in its parent's, R M Rᵀ."""
        if self.frame.turns:
            m = self._turned(m, is_symmetric)
        return conjugate(self.frame.rotation, m, is_symmetric)

    def _turned(self, m: Matrix, is_symmetric: bool) -> Matrix:
        """Rz M Rzᵀ, in half the operations of two products: the part across z turns by twice the angle."""
        (a, b, x), (e, d, y), (u, v, z) = m
        cos, sin = self.cos, self.sin
        apart, both = a - d, b + e
        change = sin * sin * apart + sin * cos * both
        other = sin * cos * apart - sin * sin * both
        column = [cos * x - sin * y, sin * x + cos * y]
        row = column if is_symmetric else [cos * u - sin * v, sin * u + cos * v]
        upper = b + other
        return [
            [a - change, upper, column[0]],
            [upper if is_symmetric else e + other, d + change, column[1]],
            [*row, z],
        ]


@dataclass(frozen=True)
class Frames:
    """All frames of a tree, parents first; `sites` as a frame and a place in it each; `num_joints` torques."""

    frames: Sequence[Frame]
    sites: Sequence[tuple[int, Vector]]
    gravity: Vector
    num_joints: int

    def ancestors(self, place: int) -> list[int]:
        """Places of the frames from this one to the world."""
        found = []
        while place >= 0:
            found.append(place)
            place = self.frames[place].parent
        return found


def frames_of(tree: Body, entry: Entry, regrouped: bool = True) -> Frames:
    """Return the frames of a tree, whose numbers `entry` gives; `regrouped` as at the top of this file."""
    frames: list[Frame] = []
    sites: list[tuple[int, Vector]] = []
    carriers: list[tuple[int, Matrix, Vector]] = []  # of each link: its frame, and its own axes and origin in it
    for place, (link, parent) in enumerate(zip(tree.links, tree.parents, strict=True)):
        at, axes, origin = carriers[parent] if parent >= 0 else (-1, UNIT, ZERO)
        placement = [[entry("rotation", place, i, j) for j in range(3)] for i in range(3)]
        origin = add(origin, apply(axes, [entry("position", place, i) for i in range(3)]))
        axes = multiply(axes, placement)
        for motion in link.joint.motions():
            turned = onto(motion.axis).tolist()
            frames.append(Frame(at, multiply(axes, turned), origin, motion.turns, len(frames)))
            at, axes, origin = len(frames) - 1, transpose(turned), ZERO
        axes = multiply(axes, link.joint.reference)
        carriers.append((at, axes, origin))
        if at >= 0:
            frames[at].body = joined(frames[at].body, _rigid(place, axes, origin, entry))
        for _ in link.points:
            number = len(sites)
            sites.append((at, add(origin, apply(axes, [entry("sites", number, i) for i in range(3)]))))
    if regrouped:
        _regroup(frames)
    return Frames(frames, sites, [entry("gravity", i) for i in range(3)], tree.num_joints)


def joined(one: RigidBody, other: RigidBody) -> RigidBody:
    """Both bodies as one, about the same origin in the same axes."""
    inertia = symmetric(lambda i, j: one.inertia[i][j] + other.inertia[i][j])
    return RigidBody(one.mass + other.mass, add(one.moment, other.moment), inertia)


def moved(body: RigidBody, place: PlacedFrame) -> RigidBody:
    """The same in the parent's axes, about its origin: with h' = R h + m p,

    I_O' = R I_O Rᵀ + (p·R h + p·h') 1 − (p (R h)ᵀ + h' pᵀ)
    """
    p, h = place.position, place.inwards(body.moment)
    moment = add(h, scale(body.mass, p))
    trace = dot(p, h) + dot(p, moment)
    turned = place.matrix_inwards(body.inertia, is_symmetric=True)
    inertia = symmetric(lambda i, j: turned[i][j] + ((trace if i == j else 0.0) - (p[i] * h[j] + moment[i] * p[j])))
    return RigidBody(body.mass, moment, inertia)


def _rigid(link: int, axes: Matrix, origin: Vector, entry: Entry) -> RigidBody:
    """A link's inertia in the frame that carries it."""
    mass = entry("mass", link)
    com = add(origin, apply(axes, [entry("com", link, i) for i in range(3)]))
    six = dict(zip(PLACES, (entry("inertia", link, i) for i in range(6)), strict=True))
    own = conjugate(axes, symmetric(lambda i, j: six[i, j]), is_symmetric=True)
    square = dot(com, com)
    inertia = symmetric(lambda i, j: own[i][j] + mass * ((square if i == j else 0.0) - com[i] * com[j]))
    return RigidBody(mass, scale(mass, com), inertia)


def _disc(across: Scalar, i: int, j: int) -> Scalar:
    return across if i == j < 2 else 0.0


def _less_disc(inertia: Matrix, across: Scalar, i: int, j: int) -> Scalar:
    return inertia[i][j] - across if i == j < 2 else inertia[i][j]


def _regroup(frames: Sequence[Frame]) -> None:
    """Give to each parent what its children's coordinates cannot move; what the world gets does not matter."""
    for frame in reversed(frames):
        (mass, h, I), place = frame.body, frame.at(0.0, 1.0, 0.0)
        if frame.turns:
            across = I[1][1]
            given = RigidBody(mass, [0.0, 0.0, h[2]], symmetric(partial(_disc, across)))
            rest = symmetric(partial(_less_disc, I, across))
            frame.body = RigidBody(0.0, [h[0], h[1], 0.0], rest)
        else:
            given = RigidBody(inertia=I)
            frame.body = RigidBody(mass, h)
        if frame.parent >= 0:
            # of a shift only the axes play a part, of a tensor alone
            frames[frame.parent].body = joined(frames[frame.parent].body, moved(given, place))
