"""Planar dynamics by recursion along the chain: any number of joints, O(K) for torques and for accelerations.

R. Featherstone, Rigid Body Dynamics Algorithms (2008), written out for the plane: recursive Newton–Euler
(chapter 5) for τ, composite rigid bodies (6) for D, articulated bodies (7) for θ̈. All vectors are in the
recording's axes. For a link of absolute angle φ, with α = φ̈, ω = φ̇ and direction u = (cos φ, sin φ):

    r = com·u, from its joint to its centre of mass      l = length·u, to the next joint
    ⊥ turns a vector by +90°, so a force f at r has the moment r⊥·f

Gravity enters as an acceleration −g of the base. Inside, the batch comes last: scalars (batch), vectors
(2, batch), matrices (2, 2, batch). Interface, shapes and units: `interface.py`.
"""

from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.dynamics.planar import PlanarDynamics, along
from invdyn.models.shapes import common


class _Link(NamedTuple):
    mass: Tensor
    inertia: Tensor
    r: Tensor
    l: Tensor
    r_turned: Tensor  # r⊥
    l_turned: Tensor  # l⊥


class RecursiveDynamics(PlanarDynamics):
    """A planar chain of any number of joints; interface, shapes and units as in `Dynamics`.

    Raises `ValueError` unless `num_joints` is a whole number ≥ 1.
    """

    def __init__(self, num_joints: int):
        if isinstance(num_joints, bool) or not isinstance(num_joints, int) or num_joints < 1:
            raise ValueError(f"expected a whole number of joints ≥ 1, got {num_joints!r}")
        self.num_joints = num_joints

    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: BodyParameters) -> Tensor:
        """τ = D θ̈ + h + c, N·m, (..., K): accelerations outwards, then forces and moments inwards."""
        p, (q, qd, qdd) = self._batch(p, q=q, qd=qd, qdd=qdd)
        links, acceleration, inertial = _links(q, p), -_vector(p.gravity), []
        for link, omega, alpha in zip(links, _absolute(qd), _absolute(qdd), strict=True):
            force = link.mass * (acceleration + alpha * link.r_turned - omega**2 * link.r)
            inertial.append((force, link.inertia * alpha + _dot(link.r_turned, force)))
            acceleration = acceleration + alpha * link.l_turned - omega**2 * link.l
        tau: list[Tensor] = []
        outer_force: Tensor = torch.zeros_like(acceleration)
        moment: Tensor | float = 0.0
        for link, (force, own_moment) in zip(reversed(links), reversed(inertial), strict=True):
            moment = moment + own_moment + _dot(link.l_turned, outer_force)
            outer_force = outer_force + force
            tau.append(moment)
        return torch.stack(tau[::-1], -1)

    def coriolis(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """h(θ, θ̇), N·m, (..., K)."""
        return self.inverse(q, qd, torch.zeros_like(qd), p._replace(gravity=torch.zeros_like(p.gravity)))

    def gravity_load(self, q: Tensor, p: BodyParameters) -> Tensor:
        """c(θ) = ∂V/∂θ, N·m, (..., K)."""
        return self.inverse(q, torch.zeros_like(q), torch.zeros_like(q), p)

    def inertia_matrix(self, q: Tensor, p: BodyParameters) -> Tensor:
        """D(θ), kg·m², (..., K, K): joint j moves all that is further out as one composite body."""
        p, (q,) = self._batch(p, q=q)
        links, D = _links(q, p), dict[tuple[int, int], Tensor]()
        mass: Tensor | float = 0.0
        inertia: Tensor | float = 0.0  # Σm, and ΣI + m r² about joint j
        moment = lever = torch.zeros_like(links[0].r)  # Σm r
        for j in reversed(range(self.num_joints)):
            link = links[j]
            own = link.inertia + link.mass * _dot(link.r, link.r)
            inertia = own + inertia + 2 * _dot(link.l, moment) + mass * _dot(link.l, link.l)
            moment = link.mass * link.r + moment + mass * link.l
            mass = link.mass + mass
            for i in reversed(range(j + 1)):
                lever = lever + links[i].l if i < j else torch.zeros_like(moment)  # from joint i to joint j
                D[i, j] = D[j, i] = inertia + _dot(lever, moment)
        rows = range(self.num_joints)
        return torch.stack([torch.stack([D[i, j] for j in rows], -1) for i in rows], -2)

    def forward(
        self, q: Tensor, qd: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None
    ) -> Tensor:
        """θ̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s², (..., K), by articulated bodies; with I_own by solving for D.

        The chain from a joint outwards answers that joint's acceleration a with the force B a + e. A link
        that carries such a chain at its end turns with J α = T − u·a, with J, u and T as below, and hands on
        a B and e of its own. No moment is handed on but τ: the joints are free to turn.
        """
        if own_inertia is not None:
            # Rotors break the recursion's "no moment but τ is handed on".
            D = self.inertia_matrix(q, p) + torch.diag_embed(own_inertia)
            return torch.linalg.solve(D, tau - self.inverse(q, qd, torch.zeros_like(q), p))
        p, (q, qd, tau) = self._batch(p, q=q, qd=qd, tau=tau)
        links, omegas, taus = _links(q, p), _absolute(qd), tau.unbind(-1)
        unit = torch.eye(2, dtype=q.dtype, device=q.device).reshape(2, 2, *[1] * (q.ndim - 1))
        B, e, solved = torch.zeros_like(unit), torch.zeros_like(links[0].r), []
        outer_tau: Tensor | float = 0.0
        for link, omega, own_tau in zip(reversed(links), reversed(omegas), reversed(taus), strict=True):
            Bl = _times(B, link.l_turned)
            e = e - omega**2 * _times(B, link.l)
            J = link.inertia + link.mass * _dot(link.r, link.r) + _dot(link.l_turned, Bl)
            u = link.mass * link.r_turned + Bl
            T = own_tau - outer_tau - _dot(link.l_turned, e)
            B = B + link.mass * unit - u.unsqueeze(0) * u.unsqueeze(1) / J
            e = e - omega**2 * link.mass * link.r + u * (T / J)
            outer_tau = own_tau
            solved.append((J, u, T))
        acceleration, qdd = -_vector(p.gravity), []
        inner: Tensor | float = 0.0
        for link, omega, (J, u, T) in zip(links, omegas, reversed(solved), strict=True):
            alpha = (T - _dot(u, acceleration)) / J
            acceleration = acceleration + alpha * link.l_turned - omega**2 * link.l
            qdd.append(alpha - inner)
            inner = alpha
        return torch.stack(qdd, -1)

    def kinetic_energy(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """½ θ̇ᵀ D θ̇, J, (...)."""
        p, (q, qd) = self._batch(p, q=q, qd=qd)
        velocity: Tensor | float = 0.0
        energy = torch.zeros_like(q[..., 0])
        for link, omega in zip(_links(q, p), _absolute(qd), strict=True):
            com_velocity = velocity + omega * link.r_turned
            energy = energy + (link.mass * _dot(com_velocity, com_velocity) + link.inertia * omega**2) / 2
            velocity = velocity + omega * link.l_turned
        return energy

    def potential_energy(self, q: Tensor, p: BodyParameters) -> Tensor:
        """V(θ) = −Σ m g·r, J, zero at the origin of the frame, (...)."""
        p, (q,) = self._batch(p, q=q)
        joint, energy = _vector(p.base), torch.zeros_like(q[..., 0])
        for link in _links(q, p):
            energy = energy - link.mass * _dot(_vector(p.gravity), joint + link.r)
            joint = joint + link.l
        return energy

    def keypoints(self, q: Tensor, p: BodyParameters) -> Tensor:
        """Positions (x, y) of the tips in the recording's frame, m, (..., K, 2)."""
        self._check(q=q)
        return p.base.unsqueeze(-2) + (p.length.unsqueeze(-1) * along(q)).cumsum(-2)

    def _batch(self, p: BodyParameters, **joint: Tensor) -> tuple[BodyParameters, list[Tensor]]:
        """All of them expanded to one batch shape, which vectors with the batch last need."""
        self._check(**joint)
        shape = common(*(value.shape[:-1] for value in (*p, *joint.values())))
        expanded = [value.expand(*shape, value.shape[-1]) for value in (*p, *joint.values())]
        return BodyParameters(*expanded[: len(p)]), expanded[len(p) :]


def _links(q: Tensor, p: BodyParameters) -> list[_Link]:
    """The links from the base outwards."""
    links = []
    columns = (value.unbind(-1) for value in (p.length, p.mass, p.com, p.inertia))
    for phi, length, mass, com, inertia in zip(_absolute(q), *columns, strict=True):
        cos, sin = phi.cos(), phi.sin()
        u, turned = torch.stack((cos, sin)), torch.stack((-sin, cos))
        links.append(_Link(mass, inertia, com * u, length * u, com * turned, length * turned))
    return links


def _absolute(relative: Tensor) -> list[Tensor]:
    """A joint quantity, relative to the parent link, as K absolute ones from the base outwards."""
    return list(accumulate(relative.unbind(-1)))


def _vector(value: Tensor) -> Tensor:
    return value.movedim(-1, 0)


def _dot(a: Tensor, b: Tensor) -> Tensor:
    return a[0] * b[0] + a[1] * b[1]


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return matrix[:, 0] * vector[0] + matrix[:, 1] * vector[1]
