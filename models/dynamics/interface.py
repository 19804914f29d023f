"""The interface of every dynamics: an articulated body's equation of motion, batched and differentiable.

    D(θ) θ̈ + h(θ, θ̇) + c(θ) = τ

Symbols and shapes, for K joints and S sites in d dimensions. Leading dimensions are batches and broadcast against those
of the body's numbers p: in the plane p.length of shape (M, 1, K) broadcasts with q of shape (M, N, K).

    q    (..., K)      θ, joint angles, rad, or the joints' other coordinates
    qd   (..., K)      θ̇, rad/s
    qdd  (..., K)      θ̈, rad/s²
    tau  (..., K)      τ, net joint torque, N·m
    D    (..., K, K)   inertia matrix, kg·m², symmetric positive definite
    h    (..., K)      Coriolis and centrifugal torque, N·m
    c    (..., K)      gravity load ∂V/∂θ, N·m, with V = −Σ m g·r
    r    (..., S, d)   sites, m, in the recording's frame

A subclass writes the abstract methods; the others follow from them, by forward-mode derivatives of the sites where
those of a motion are needed, and may be written out where that is faster.
"""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any

import torch
from torch import Tensor


class Dynamics(ABC):
    """What a body of `num_joints` joints does; symbols, shapes and units at the top of this file.

    Every method keeps the floating dtype of its tensors, is twice differentiable in all of them, and raises
    `ValueError` when the last dimension of a joint quantity is not `num_joints`.
    """

    num_joints: int

    @abstractmethod
    def inertia_matrix(self, q: Tensor, p: Any) -> Tensor:
        """D(θ), kg·m², (..., K, K)."""

    @abstractmethod
    def coriolis(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """h(θ, θ̇), N·m, (..., K)."""

    @abstractmethod
    def gravity_load(self, q: Tensor, p: Any) -> Tensor:
        """c(θ) = ∂V/∂θ, N·m, (..., K)."""

    @abstractmethod
    def forward(self, q: Tensor, qd: Tensor, tau: Tensor, p: Any, own_inertia: Tensor | None = None) -> Tensor:
        """θ̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s², (..., K); I_own (..., K) kg·m², of geared rotors, or None."""

    @abstractmethod
    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: Any) -> Tensor:
        """τ = D θ̈ + h + c, N·m, (..., K)."""

    @abstractmethod
    def kinetic_energy(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """½ θ̇ᵀ D θ̇, J, (...)."""

    @abstractmethod
    def potential_energy(self, q: Tensor, p: Any) -> Tensor:
        """V(θ) = −Σ m g·r, J, zero at the origin of the frame, (...)."""

    @abstractmethod
    def keypoints(self, q: Tensor, p: Any) -> Tensor:
        """Positions of the sites in the recording's frame, m, (..., S, d)."""

    # -- what follows --------------------------------------------------------------------------
    def response(self, q: Tensor, tau: Tensor, p: Any, own_inertia: Tensor | None = None) -> Tensor:
        """(D + diag I_own)⁻¹ τ, rad/s², (..., K): what a torque adds to the acceleration."""
        weightless = p._replace(gravity=torch.zeros_like(p.gravity))
        return self.forward(q, torch.zeros_like(q), tau, weightless, own_inertia)

    def uniform_load(self, q: Tensor, field: Tensor, p: Any) -> Tensor:
        """The load c(θ) in another gravity ``field`` (..., d) m/s², N·m, (..., K); linear in it."""
        return self.gravity_load(q, p._replace(gravity=field))

    def power(self, qd: Tensor, tau: Tensor) -> Tensor:
        """Mechanical power τ θ̇ that each joint's torque gives to the body, W, (..., K)."""
        return tau * qd

    def jacobian(self, q: Tensor, p: Any) -> Tensor:
        """∂r/∂θ, m/rad, (..., S, d, K)."""
        units = torch.eye(self.num_joints, dtype=q.dtype, device=q.device)
        columns = [self.site_velocities(q, unit.expand_as(q), p) for unit in units]
        return torch.stack(columns, -1)

    def site_velocities(self, q: Tensor, qd: Tensor, p: Any) -> Tensor:
        """ṙ = J θ̇, m/s, (..., S, d)."""
        q, qd = _together(q, qd)
        return jvp(lambda angles: self.keypoints(angles, p), (q,), (qd,))

    def site_accelerations(self, q: Tensor, qd: Tensor, qdd: Tensor, p: Any) -> Tensor:
        """r̈ = J θ̈ + J̇ θ̇, m/s², (..., S, d)."""
        q, qd, qdd = _together(q, qd, qdd)
        return jvp(lambda angles, rates: self.site_velocities(angles, rates, p), (q, qd), (qd, qdd))

    def torque_of(self, q: Tensor, site: int, force: Tensor, p: Any) -> Tensor:
        """Jᵀ F, N·m, (..., K), of a force (..., d) N that pulls at a site."""
        return (self.jacobian(q, p)[..., site, :, :] * force.unsqueeze(-1)).sum(-2)

    # -- what is large and small, of numbers without batch dimensions -----------------------------
    def typical_inertia(self, p: Any) -> Tensor:
        """Inertia (K,) about each joint with all coordinates at zero, kg·m²."""
        return self.inertia_matrix(p.gravity.new_zeros(self.num_joints), p).diagonal()

    def typical_load(self, p: Any) -> Tensor:
        """Load (K,) of gravity there, N·m, from the direction that loads each joint most."""
        there, size = p.gravity.new_zeros(self.num_joints), p.gravity.norm()
        ways = torch.eye(p.gravity.shape[-1], dtype=p.gravity.dtype, device=p.gravity.device)
        return torch.stack([self.gravity_load(there, p._replace(gravity=size * way)) for way in ways]).norm(dim=0)

    def reach(self, p: Any) -> Tensor:
        """Largest distance () between any two sites, or a site and the frame's origin, at zero coordinates, m.

        Or the largest of :meth:`levers`, where that is more. Without sites that move it is 1 m.
        """
        points = self.keypoints(p.gravity.new_zeros(self.num_joints), p)
        points = torch.cat([points, points.new_zeros(1, points.shape[-1])])
        return torch.maximum(torch.cdist(points, points).max(), self.levers(p).max())

    def levers(self, p: Any) -> Tensor:
        """How far (K,) some site moves when a joint turns by a radian, m: what an error of a point is divided by.

        The largest one's stands for a joint that moves no site at zero coordinates; if none moves any it is 1 m.
        """
        jacobian = self.jacobian(p.gravity.new_zeros(self.num_joints), p)
        moved = torch.cat([jacobian.norm(dim=-2), p.gravity.new_zeros(1, self.num_joints)]).amax(0)
        largest = moved.max()
        return torch.where(moved > 0, moved, torch.where(largest > 0, largest, 1.0))

    def _check(self, **joint: Tensor) -> None:
        for name, value in joint.items():
            if value.shape[-1:] != (self.num_joints,):
                raise ValueError(
                    f"expected {name} of shape (..., {self.num_joints}), one entry for each joint, "
                    f"got {tuple(value.shape)}"
                )


def _together(*values: Tensor) -> list[Tensor]:
    """Values of one shape, each entry in a place of its own, which torch's forward mode asks for."""
    return [value.contiguous() for value in torch.broadcast_tensors(*values)]


def jvp(function: Callable[..., Tensor], at: tuple[Tensor, ...], along: tuple[Tensor, ...]) -> Tensor:
    """Derivative of a function along a direction, by torch's forward mode."""
    _import_forward_mode()
    return torch.func.jvp(function, at, along)[1]


@cache
def _import_forward_mode() -> None:
    with warnings.catch_warnings():
        # At first use torch imports what it deprecates itself.
        warnings.simplefilter("ignore", DeprecationWarning)
        from torch._decomp import decompositions_for_jvp  # noqa: F401
