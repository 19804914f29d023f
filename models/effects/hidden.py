"""States that no sensor shows: of a hinge, one coordinate ψ more in a chain of K + 1 links, or of what follows the arm.

What follows (:class:`Follower`) has no part in how the arm moves. A hinge makes two links of one: a flexible link bends
there, a joint with backlash has its gap there. The state gains (ψ, ψ̇); the tracked joints keep their K angles, and all
else of the model is as it was.

    chain      the K + 1 links                                      BodyParameters → BodyParameters
    all_hinges the K joints and the hinge as angles of that chain   q (..., K), ψ (..., 1) → (..., K + 1)
    gathered   its inverse

The other effects act on the K joints; forces on points of the arm (stage ``pull``) rotate the hinge as well.
"""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.dynamics.integrators import rk4
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.dynamics.planar import planar_dynamics
from invdyn.models.effects.base import Effect, Scale, Values
from invdyn.models.shapes import join, joined_by_column

Net = Callable[[Tensor, Tensor, float | Tensor], tuple[Tensor, Tensor | None]]
"""(q, q̇, fraction of the step) → the torques on the joints and the joints' own inertias (or None), (..., K)."""
Pull = Callable[[Tensor, Tensor, float | Tensor], Tensor | float]
"""(angles, rates, fraction of the step) → what forces on points of the arm do to the K + 1 hinges beyond those torques.

Torques as of the rigid arm, at the joints alone, are what they are counted from."""

Halves = tuple[Tensor, Tensor]
"""A number of the link before a hidden hinge, and of that behind it, (..., 1) each."""
Motion = tuple[Tensor, Tensor]
"""Positions of the K tips from the base, m, and their velocities, m/s, (..., K, 2)."""


class Row(NamedTuple):
    """What moves an arm with a hidden hinge in one row of ``dt`` s, (..., 1), in ``parts`` sub-steps or more."""

    body: BodyParameters
    rigid: Dynamics
    """Of the K links."""
    net: Net
    pull: Pull
    dt: Tensor
    parts: int


class Hidden(Effect):
    """Base of the effects with hidden states, coordinates and then any rates.

    At most one that moves the arm in a model, and any number of what follows it.
    """

    states: ClassVar[int]
    """H, how many."""
    forgets: ClassVar[bool] = False
    """Whether contact makes its motion forget what was before."""

    @abstractmethod
    def hidden_scale(self, scale: Scale) -> tuple[float, ...]:
        """How far the H states may be from 0 at the first row: standard deviations."""


class Follower(Hidden):
    """Base of what follows the arm's motion and has no part in it."""

    planar = True

    @abstractmethod
    def follow(self, p: Values, hidden: Tensor, before: Motion, after: Motion, dt: Tensor) -> Tensor:
        """States (..., H) a row of ``dt`` s later, between what the K tips do at its two ends."""

    @abstractmethod
    def shown(self, tips: Tensor, hidden: Tensor) -> Tensor:
        """What is seen as the K ``tips``, (..., K, 2) m."""


class HiddenHinge(Hidden):
    """Base of the effects with a hidden hinge, of states ψ, rad, and ψ̇, rad/s."""

    planar = True
    states = 2

    @abstractmethod
    def halves(self, p: Values, length: Tensor, mass: Tensor, com: Tensor, inertia: Tensor) -> Iterable[Halves]:
        """Of the link's four numbers (..., 1) those of the link before the hinge, and of that behind it."""

    def chain(self, p: Values, body: BodyParameters) -> BodyParameters:
        """The K + 1 links."""
        k = self.place[0]
        pairs = self.halves(p, *(value[..., k : k + 1] for value in body[:4]))
        split = [join(x[..., :k], *pair, x[..., k + 1 :]) for x, pair in zip(body[:4], pairs, strict=True)]
        return BodyParameters._make([*split, *body[4:]])

    @staticmethod
    def whole(q: Tensor) -> Dynamics:
        """Dynamics of the chain with the hinge, of joints' angles (..., K)."""
        return planar_dynamics(q.shape[-1] + 1)

    @abstractmethod
    def all_hinges(self, q: Tensor, hinge: Tensor) -> Tensor:
        """Angles, or rates, of the K + 1 hinges."""

    @abstractmethod
    def gathered(self, angles: Tensor) -> tuple[Tensor, Tensor]:
        """Angles, or rates, of the K joints, and of the hinge (..., 1)."""

    def own_angles(self, angles: Tensor) -> Tensor:
        """The joints' own part, (..., K), of the angles, or rates, of the K + 1 hinges.

        It is what springs, stops and friction at the joints know of.
        """
        return self.gathered(angles)[0]

    def on_joints(self, values: Any) -> Any:
        """Torques or inertias (..., K) of the joints as those of K + 1 hinges, none on the hidden one; or None."""
        if values is None:
            return None
        k = self.place[0]
        return joined_by_column(values[..., : k + 1], torch.zeros_like(values[..., :1]), values[..., k + 1 :])

    @abstractmethod
    def rigid(self, p: Values) -> Tensor:
        """Where (..., 1) its parameters make no hinge of it."""

    @abstractmethod
    def bent(self, p: Values, row: Row, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(ψ, ψ̇) (..., 2), q and q̇ (..., K) one row later, where it is a hinge.

        By Runge–Kutta of order 4, with any integrator of the model.
        """

    def step(self, p: Values, row: Row, hidden: Tensor, q: Tensor, qd: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The same anywhere: of an arm without hinge, the rigid one's, and ψ at 0."""

        def locked(q: Tensor, qd: Tensor, s: float) -> Tensor:
            torque, own = row.net(q, qd, s)
            return row.rigid.forward(q, qd, torque, row.body, own)

        rigid = self.rigid(p)
        if not bool(rigid.any()):
            return self.bent(p, row, hidden, q, qd)
        still = torch.zeros_like(hidden), *rk4(locked, q, qd, row.dt, row.parts)
        if bool(rigid.all()):
            return still
        bent = self.bent(p, row, hidden, q, qd)
        state, q, qd = (torch.where(rigid, *each) for each in zip(still, bent, strict=True))
        return state, q, qd

    def tips(self, p: Values, q: Tensor, hidden: Tensor, body: BodyParameters) -> Tensor:
        """The K tips, (..., K, 2) m."""
        return self._tracked(self.whole(q).keypoints(self.all_hinges(q, hidden[..., :1]), self.chain(p, body)))

    def tip_motion(self, p: Values, q: Tensor, qd: Tensor, hidden: Tensor, body: BodyParameters) -> Motion:
        """What the K tips do; see :func:`tip_motion`."""
        angles, rates = (
            self.all_hinges(joints, hinge) for joints, hinge in zip((q, qd), hidden.chunk(2, -1), strict=True)
        )
        points, velocities = tip_motion(angles, rates, self.chain(p, body))
        return self._tracked(points), self._tracked(velocities)

    def _tracked(self, points: Tensor) -> Tensor:
        """Of the ends of K + 1 links (..., K + 1, 2) those of the arm's own."""
        k = self.place[0]
        return torch.cat([points[..., :k, :], points[..., k + 1 :, :]], -2)


def tip_motion(q: Tensor, qd: Tensor, body: BodyParameters) -> Motion:
    """The tips as seen from the base, m, and their velocities, m/s, (..., K, 2), at angles and rates (..., K)."""
    phi, omega = q.cumsum(-1), qd.cumsum(-1)
    along, up = body.length * phi.cos(), body.length * phi.sin()
    points, velocities = torch.stack([along, up], -1), torch.stack([-up * omega, along * omega], -1)
    return points.cumsum(-2), velocities.cumsum(-2)


def substeps_for(dt: Tensor | float, frequency: float, n: int) -> int:
    """Sub-steps in which Runge–Kutta of order 4 follows an oscillation of ``frequency`` Hz: a radian each at most."""
    longest = dt.max().item() if isinstance(dt, Tensor) else dt
    return max(n, math.ceil(longest * 2 * math.pi * frequency))
