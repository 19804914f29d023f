"""A smooth torque with a rough one on it: a Matérn-5/2 process plus an Ornstein–Uhlenbeck process.

A motor's or a limb's intended torque is smooth; disturbances are rough and small. A process of one smoothness is either
too rough for the first, with wide bands, or too smooth for the second, with bands that are too narrow. Sums of
kernels are kernels: C. E. Rasmussen & C. K. I. Williams, Gaussian Processes for Machine Learning (2006), section 4.2.4.

    τ = s + r,    s Matérn-5/2 of marginal sd σ and length scale ℓ,    r Ornstein–Uhlenbeck of marginal sd ρ and decay λ

State z = (τ, s, ṡ, s̈): all torques, all smooth parts, their first derivatives (N·m/s), their second ones. Over δ

    τ' = s' + e^(−λδ) (τ − s) + ρ √(1 − e^(−2λδ)) η

and the root of the covariance of (τ, s, ṡ, s̈) comes by a QR of both parts' roots, with no subtraction anywhere.

At ρ = 0 exactly z has no density, which methods need: take Matérn-3/2 by itself.

Parameters (..., K): "torque.scale" σ (N·m), "torque.lengthscale" ℓ (s), "torque.rough_scale" ρ (N·m) and
"torque.rough_decay" λ (1/s).
"""

import torch
from torch import Tensor

from invdyn.models.torques.base import Parameters, TorqueProcess, from_torques
from invdyn.models.torques.matern import Matern52, interleaved, triangular


class SmoothAndRough(TorqueProcess):
    """See the top of the file; the rough part starts at ``share`` of the smooth one's sd."""

    diagonal, torques_suffice = False, True

    def __init__(self, lengthscale: float = 0.2, share: float = 0.1, decay: float = 20.0):
        self.smooth, self.share, self.decay = Matern52(lengthscale), share, decay

    def size(self, num_joints: int) -> int:
        """The torques, their smooth parts and those's derivatives."""
        return num_joints + self.smooth.size(num_joints)

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """σ = ``scale``, and the others as given."""
        rough = {"torque.rough_scale": self.share * scale, "torque.rough_decay": from_torques(scale, self.decay)}
        return self.smooth.defaults(scale) | rough

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """Mean of each part by its own law, (..., 4K)."""
        K = z.shape[-1] // self.size(1)
        torque, smooth = z[..., :K], z[..., K:]
        after = self.smooth.mean(smooth, dt, parameters)
        rough = torch.exp(-parameters["torque.rough_decay"] * dt) * (torque - smooth[..., :K])
        return torch.cat([after[..., :K] + rough, after], -1)

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of one step's covariance, (..., 4K, 4K)."""
        new = torch.sqrt(-torch.expm1(-2 * parameters["torque.rough_decay"] * dt))
        return self._joined(self.smooth.noise_blocks(dt, parameters), parameters["torque.rough_scale"] * new)

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Lower-triangular square root of the stationary covariance, (..., 4K, 4K)."""
        return self._joined(self.smooth.stationary_blocks(parameters), parameters["torque.rough_scale"])

    def path(self, torque: Tensor, time: Tensor) -> Tensor:
        """Torques that are smooth, and their derivatives, (T, 4K)."""
        return torch.cat([torque, self.smooth.path(torque, time)], -1)

    @staticmethod
    def _joined(smooth: Tensor, rough: Tensor) -> Tensor:
        """Root of the covariance of (s + r, s, ṡ, s̈) from roots (..., K, n, n) of s and sd (..., K) of r."""
        rough = rough.expand(smooth.shape[:-2])
        first = torch.cat([smooth[..., 0, :], rough.unsqueeze(-1)], -1)
        others = torch.cat([smooth, torch.zeros_like(smooth[..., :1])], -1)
        return interleaved(triangular(torch.cat([first.unsqueeze(-2), others], -2)))
