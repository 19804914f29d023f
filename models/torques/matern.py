"""Gaussian-process torque with a Matérn-3/2 or -5/2 kernel, in state-space form.

Hartikainen & Särkkä, "Kalman filtering and smoothing solutions to temporal Gaussian process
regression models" (2010). With κ = √(2ν)/ℓ the process and its derivatives z = (τ, τ̇[, τ̈])
obey dz = F z dt + b dβ, where F is the companion matrix of (s + κ)^(ν+1/2) and

    A(δ) = exp(F δ) = e^(−κδ) Σ_j (F + κI)^j δ^j / j!        (nilpotent: the sum ends)
    Q(δ) = ∫_0^δ A(s) b q bᵀ A(s)ᵀ ds,   q = 4 κ³ σ²  or  16/3 κ⁵ σ².

Q is ill-conditioned for κδ ≪ 1 (entries fall as δ⁵), so its *square root* is computed: Gauss–Legendre
nodes turn the integral into a sum of outer products, and a QR of the stacked factors is the
triangular root, with no subtraction anywhere. Noise older than 20/κ is forgotten (e^−40), so the
integral ends there: a long gap in the recording needs no more nodes than a frame.

Parameters (..., K): "torque.scale" σ (N·m, marginal sd), "torque.lengthscale" ℓ (s).
z holds all torques, then all first derivatives (N·m/s), then all second ones.
"""

import math

import numpy as np
import torch
from torch import Tensor

from invdyn.models.shapes import join
from invdyn.models.torques.base import Parameters, TorqueProcess, from_torques

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


class Matern(TorqueProcess):
    """State-space Matérn process of half-integer smoothness; use :class:`Matern32` or :class:`Matern52`."""

    order: int
    """Number of state entries per joint, ν + 1/2."""
    diagonal, torques_suffice = False, True

    def __init__(self, lengthscale: float = 0.2):
        self.lengthscale = lengthscale

    def size(self, num_joints: int) -> int:
        """The torques and their derivatives."""
        return self.order * num_joints

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """σ = ``scale`` and the length scale as given."""
        return {"torque.scale": scale.clone(), "torque.lengthscale": from_torques(scale, self.lengthscale)}

    def _rate(self, parameters: Parameters) -> Tensor:
        return math.sqrt(2 * self.order - 1) / parameters["torque.lengthscale"]

    def _companion(self, rate: Tensor) -> Tensor:
        """F (..., n, n)."""
        n = self.order
        rows = torch.diag(rate.new_ones(n - 1), 1).expand(*rate.shape, n, n).clone()
        for j in range(n):
            rows[..., n - 1, j] = -math.comb(n, j) * rate ** (n - j)
        return rows

    def _propagator(self, rate: Tensor, dt: Tensor) -> Tensor:
        """A(δ) (..., n, n), by the finite series."""
        identity = torch.eye(self.order, dtype=rate.dtype, device=rate.device)
        nilpotent = self._companion(rate) + rate[..., None, None] * identity
        term, total = identity, identity
        for j in range(1, self.order):
            term = term @ nilpotent * (dt[..., None, None] / j)
            total = total + term
        return torch.exp(-rate * dt)[..., None, None] * total

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """A(δ) z, (..., nK)."""
        parts = z.unflatten(-1, (self.order, -1)).unbind(-2)  # each (..., K): whole columns take half the time
        rows = self._propagator(self._rate(parameters), dt).unbind(-2)
        return join(*(sum(own * part for own, part in zip(row.unbind(-1), parts, strict=True)) for row in rows))

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of Q(δ), (..., nK, nK)."""
        return interleaved(self.noise_blocks(dt, parameters))

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of the stationary covariance, (..., nK, nK)."""
        return interleaved(self.stationary_blocks(parameters))

    def noise_blocks(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of each joint's Q(δ), (..., K, n, n)."""
        rate = self._rate(parameters)
        spectral = self._spectral_density(rate, parameters["torque.scale"])
        rate, dt, spectral = torch.broadcast_tensors(rate, dt, spectral)
        dt = torch.minimum(dt, 20 / rate)
        nodes = torch.as_tensor((_NODES + 1) / 2, dtype=rate.dtype, device=rate.device)
        weights = torch.as_tensor(_WEIGHTS / 2, dtype=rate.dtype, device=rate.device)
        columns = self._propagator(rate.unsqueeze(-1), dt.unsqueeze(-1) * nodes)[..., -1]  # A(s) b
        factors = columns * torch.sqrt(spectral * dt)[..., None, None] * weights.sqrt()[:, None]
        return triangular(factors.mT)

    def stationary_blocks(self, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of each joint's stationary covariance, (..., K, n, n)."""
        raise NotImplementedError

    def path(self, torque: Tensor, time: Tensor) -> Tensor:
        """Torques and their finite-difference derivatives, (T, nK)."""
        pieces = [torque]
        for _ in range(self.order - 1):
            pieces.append(torch.gradient(pieces[-1], spacing=(time,), dim=0)[0])
        return torch.cat(pieces, -1)

    def _spectral_density(self, rate: Tensor, scale: Tensor) -> Tensor:
        raise NotImplementedError


def triangular(root: Tensor) -> Tensor:
    """Lower-triangular L (..., n, n) with L Lᵀ = R Rᵀ, of a root R (..., n, m ≥ n)."""
    # Reduced, as torch cannot differentiate mode="r".
    upper = torch.linalg.qr(root.mT, mode="reduced").R
    negative = upper.diagonal(dim1=-2, dim2=-1) < 0  # of a root without full rank some are 0, and stay as they are
    return torch.where(negative.unsqueeze(-2), -upper.mT, upper.mT)


def interleaved(blocks: Tensor) -> Tensor:
    """(..., K, n, n) per joint → (..., nK, nK), all joints' first entries, then all second ones."""
    eye = torch.eye(blocks.shape[-3], dtype=blocks.dtype, device=blocks.device)
    full = torch.einsum("...kab,kl->...akbl", blocks, eye)
    return full.flatten(-4, -3).flatten(-2, -1)


class Matern32(Matern):
    """Once differentiable torque."""

    order = 2

    def _spectral_density(self, rate: Tensor, scale: Tensor) -> Tensor:
        return 4 * rate**3 * scale**2

    def stationary_blocks(self, parameters: Parameters) -> Tensor:
        """Square root of the stationary covariance diag(σ², κ²σ²)."""
        rate, scale = torch.broadcast_tensors(self._rate(parameters), parameters["torque.scale"])
        return torch.diag_embed(torch.stack([scale, rate * scale], -1))


class Matern52(Matern):
    """Twice differentiable torque."""

    order = 3

    def _spectral_density(self, rate: Tensor, scale: Tensor) -> Tensor:
        return 16 / 3 * rate**5 * scale**2

    def stationary_blocks(self, parameters: Parameters) -> Tensor:
        """Square root of the stationary covariance: σ², κ²σ²/3, κ⁴σ² and cov(τ, τ̈) = −κ²σ²/3."""
        rate, scale = torch.broadcast_tensors(self._rate(parameters), parameters["torque.scale"])
        sds = torch.stack([scale, rate * scale / math.sqrt(3), rate**2 * scale * math.sqrt(8) / 3], -1)
        lower = torch.diag_embed(sds)
        lower[..., 2, 0] = -(rate**2) * scale / 3
        return lower
