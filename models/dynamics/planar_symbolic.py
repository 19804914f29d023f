"""The interface of every dynamics: the equation of motion of a planar chain, batched and differentiable.

    D(θ) θ̈ + h(θ, θ̇) + c(θ) = τ

Symbols and shapes, for K joints. Leading dimensions are batches and broadcast against those of the
`BodyParameters` p: p.length of shape (M, 1, K) goes with q of shape (M, N, K).

    q    (..., K)      θ, joint angles, rad, Denavit–Hartenberg (see `body.py`)
    qd   (..., K)      θ̇, rad/s
    qdd  (..., K)      θ̈, rad/s²
    tau  (..., K)      τ, net joint torque, N·m
    D    (..., K, K)   inertia matrix, kg·m², symmetric positive definite
    h    (..., K)      Coriolis and centrifugal torque, N·m
    c    (..., K)      gravity load ∂V/∂θ, N·m, with V = −Σ m g·r
"""

from abc import ABC, abstractmethod

import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters


class Dynamics(ABC):
    """What a chain of `num_joints` links does; symbols, shapes and units at the top of this file.

    Every method keeps the floating dtype of its tensors, is twice differentiable in all of them, and raises
    `ValueError` when the last dimension of a joint quantity is not `num_joints`.
    """

    num_joints: int

    @abstractmethod
    def inertia_matrix(self, q: Tensor, p: BodyParameters) -> Tensor:
        """D(θ), kg·m², (..., K, K)."""

    @abstractmethod
    def coriolis(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """h(θ, θ̇), N·m, (..., K)."""

    @abstractmethod
    def gravity_load(self, q: Tensor, p: BodyParameters) -> Tensor:
        """c(θ) = ∂V/∂θ, N·m, (..., K)."""

    @abstractmethod
    def forward(
        self, q: Tensor, qd: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None
    ) -> Tensor:
        """θ̈ = (D + diag I_own)⁻¹(τ − h − c), rad/s², (..., K); I_own (..., K) kg·m², of geared rotors, or None."""

    @abstractmethod
    def inverse(self, q: Tensor, qd: Tensor, qdd: Tensor, p: BodyParameters) -> Tensor:
        """τ = D θ̈ + h + c, N·m, (..., K)."""

    @abstractmethod
    def kinetic_energy(self, q: Tensor, qd: Tensor, p: BodyParameters) -> Tensor:
        """½ θ̇ᵀ D θ̇, J, (...)."""

    @abstractmethod
    def potential_energy(self, q: Tensor, p: BodyParameters) -> Tensor:
        """V(θ) = −Σ m g·r, J, zero at the origin of the frame, (...)."""

    @abstractmethod
    def keypoints(self, q: Tensor, p: BodyParameters) -> Tensor:
        """Positions (x, y) of the tips in the recording's frame, m, (..., K, 2)."""

    def response(self, q: Tensor, tau: Tensor, p: BodyParameters, own_inertia: Tensor | None = None) -> Tensor:
        """(D + diag I_own)⁻¹ τ, rad/s², (..., K): what a torque adds to the acceleration."""
        weightless = p._replace(gravity=torch.zeros_like(p.gravity))
        return self.forward(q, torch.zeros_like(q), tau, weightless, own_inertia)

    def power(self, qd: Tensor, tau: Tensor) -> Tensor:
        """Mechanical power τ θ̇ that each joint's torque gives to the body, W, (..., K)."""
        return tau * qd

    def _check(self, **joint: Tensor) -> None:
        for name, value in joint.items():
            if value.shape[-1:] != (self.num_joints,):
                raise ValueError(
                    f"expected {name} of shape (..., {self.num_joints}), one entry for each joint, "
                    f"got {tuple(value.shape)}"
                )
