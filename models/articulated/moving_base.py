"""A base that moves: the place of the first joint as a process next to the torques, which carries the body.

The acceleration of each axis is a stationary Matérn-3/2 process, so that b is its double integral. R. A. Singer,
"Estimating optimal tracking filter performance for manned maneuvering targets", IEEE Transactions on Aerospace and
Electronic Systems 6 (1970), 473–483, has a rougher one, of order 1. With κ = √3/ℓ the state (b, ḃ, b̈, b⃛) obeys

    dy = F y dt + e₄ dβ,   F y = (ḃ, b̈, b⃛, −κ² b̈ − 2 κ b⃛),   spectral density of β  4 κ³ σ²

In the frame of a base that translates, all points have the acceleration −b̈ more. So the body moves as on a base at
rest in a gravity g − b̈(t), which is exact as long as the base does not turn, and each point is seen b(t) farther.

Over a step δ, with all entries in units of δ, Φ = exp(F δ) by torch's matrix exponential (to 1e-12 for κδ from 0 to
1,000); the root of the noise's covariance is a QR of Gauss–Legendre nodes, as in :mod:`..torques.matern`.

Parameters (..., d): "base.scale" σ (m/s², sd of b̈), "base.lengthscale" ℓ (s); of the first row "base.place_scale" (m)
and "base.speed_scale" (m/s), standard deviations of b and ḃ about 0.
Shapes: d axes, states (..., 4 d), all b first, then all ḃ, b̈ and b⃛.
"""

import math

import numpy as np
import torch
from torch import Tensor

from invdyn.models.shapes import common, join
from invdyn.models.torques.base import Parameters, TorqueProcess
from invdyn.models.torques.matern import interleaved, triangular

ORDER = 4
"""States of an axis."""
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


class MovingBase:
    """Of ``axes`` d; see the top of the file."""

    def __init__(self, axes: int):
        self.axes = axes

    @property
    def size(self) -> int:
        """States, 4 d."""
        return ORDER * self.axes

    def defaults(self) -> dict[str, Tensor]:
        """Accelerations of 1 m/s² that last .2 s; a place within 1 m, and a speed within 1 m/s."""
        every = {"scale": 1.0, "lengthscale": 0.2, "place_scale": 1.0, "speed_scale": 1.0}
        return {f"base.{name}": torch.full((self.axes,), value).double() for name, value in every.items()}

    def parted(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """b, ḃ and b̈, (..., d) each, of states (..., 4 d)."""
        place, speed, acceleration, _ = state.split(self.axes, -1)
        return place, speed, acceleration

    def mean(self, state: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """Φ(δ) y, (..., 4 d), after ``dt`` (..., 1) s."""
        blocks = state.unflatten(-1, (ORDER, -1)).transpose(-1, -2)
        matrix = self.propagator(dt, parameters)
        return (matrix * blocks.unsqueeze(-2)).sum(-1).transpose(-1, -2).flatten(-2)

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of the noise's covariance over ``dt`` s, (..., 4 d, 4 d)."""
        return interleaved(self.noise_blocks(dt, parameters))

    def initial(self, parameters: Parameters) -> Tensor:
        """That of the first row's state: b̈ and b⃛ are stationary."""
        return torch.diag_embed(self.initial_sd(parameters).transpose(-1, -2).flatten(-2))

    def initial_sd(self, parameters: Parameters) -> Tensor:
        """Standard deviations (..., d, 4) of the first row's state."""
        scale, place, speed = (parameters[f"base.{name}"] for name in ("scale", "place_scale", "speed_scale"))
        return torch.stack(torch.broadcast_tensors(place, speed, scale, self._rate(parameters) * scale), -1)

    def propagator(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Φ(δ) of each axis, (..., d, 4, 4)."""
        rate, dt = torch.broadcast_tensors(self._rate(parameters), dt)
        units = torch.stack([torch.ones_like(dt), dt, dt**2, dt**3], -1)
        return torch.linalg.matrix_exp(_unit_rates(rate * dt)) * (units.unsqueeze(-2) / units.unsqueeze(-1))

    def noise_blocks(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of each axis's noise, (..., d, 4, 4)."""
        rate, dt, scale = torch.broadcast_tensors(self._rate(parameters), dt, parameters["base.scale"])
        x = rate * dt
        share, weights = (torch.as_tensor(each / 2).to(rate) for each in (_NODES + 1, _WEIGHTS))
        # What an impulse in b⃛ has become a share of the step later, in units of δ.
        columns = torch.linalg.matrix_exp(_unit_rates(x)[..., None, :, :] * share[:, None, None])[..., -1]
        size = 2 * x**1.5 * scale * dt**2  # √(4 κ³ σ² δ⁷), as b⃛ has the unit δ⁻³
        factors = columns * (size.unsqueeze(-1) * weights.sqrt()).unsqueeze(-1)
        return triangular(factors.mT) / torch.stack([torch.ones_like(dt), dt, dt**2, dt**3], -1).unsqueeze(-1)

    def _rate(self, parameters: Parameters) -> Tensor:
        return math.sqrt(3) / parameters["base.lengthscale"]


class OnMovingBase(TorqueProcess):
    """A torque process and the motion of a base, independent of it, as one: z = (torque's own, y)."""

    diagonal = False

    def __init__(self, torque: TorqueProcess, base: MovingBase):
        self.torque, self.base = torque, base

    def size(self, num_joints: int) -> int:
        """Of both."""
        return self.torque.size(num_joints) + self.base.size

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """Of both."""
        return {**self.torque.defaults(scale), **self.base.defaults()}

    def parted(self, z: Tensor) -> tuple[Tensor, Tensor]:
        """The torque process's own state, and the base's (..., 4 d)."""
        return z[..., : -self.base.size], z[..., -self.base.size :]

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """Of each by its own law."""
        torque, state = self.parted(z)
        return join(self.torque.mean(torque, dt, parameters), self.base.mean(state, dt, parameters))

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root, of two blocks."""
        return self._joined(self.torque.noise(dt, parameters), self.base.noise(dt, parameters))

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """That of the first row, of two blocks."""
        return self._joined(self.torque.stationary(dt, parameters), self.base.initial(parameters))

    def path(self, torque: Tensor, time: Tensor) -> Tensor:
        """With a base at rest."""
        return join(self.torque.path(torque, time), torque.new_zeros(len(torque), self.base.size))

    def _joined(self, torque: Tensor, base: Tensor) -> Tensor:
        own = torch.diag_embed(torque) if self.torque.diagonal else torque
        batch, sizes = common(own.shape[:-2], base.shape[:-2]), (own.shape[-1], base.shape[-1])
        root = own.new_zeros(*batch, sum(sizes), sum(sizes))
        root[..., : sizes[0], : sizes[0]] = own
        root[..., sizes[0] :, sizes[0] :] = base
        return root


def _unit_rates(x: Tensor) -> Tensor:
    """F in units of δ, (..., 4, 4), for κδ = ``x`` (...)."""
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    rows = [zero, one, zero, zero], [zero, zero, one, zero], [zero, zero, zero, one], [zero, zero, -(x**2), -2 * x]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)
