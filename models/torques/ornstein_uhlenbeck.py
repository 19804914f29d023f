"""Ornstein–Uhlenbeck torque, eq. 2 of Biderman et al. (2020), and its limit, the random walk.

    τ̇ = −λ τ + σ η      λ = "torque.decay" (1/s),  σ = "torque.scale"

How much noise one step of length δ carries is a choice, by name:

| scaling   | mean         | noise sd                     | unit of σ       |
|-----------|--------------|------------------------------|-----------------|
| "printed" | (1 − λδ) τ   | δ σ                          | N·m/s           |
| "wiener"  | (1 − λδ) τ   | √δ σ                         | N·m/√s          |
| "exact"   | e^(−λδ) τ    | σ √((1 − e^(−2λδ)) / (2λ))   | N·m/√s          |

"printed" is the paper's covariance δ²σ²; its torque becomes smooth as δ → 0, so its σ belongs
to one frame rate. "wiener" is Euler–Maruyama with a true Wiener increment; "exact" is the
process itself, the right one for irregular or coarse sampling.
"""

import torch
from torch import Tensor

from invdyn.models.torques.base import Parameters, TorqueProcess, from_torques

SCALINGS = ("printed", "wiener", "exact")


class OrnsteinUhlenbeck(TorqueProcess):
    """Ornstein–Uhlenbeck torque; ``scaling`` is "printed", "wiener" or "exact" (default)."""

    def __init__(self, scaling: str = "exact", decay: float = 5.0):
        if scaling not in SCALINGS:
            raise ValueError(f"expected a noise scaling among {', '.join(SCALINGS)}, got {scaling!r}")
        self.scaling = scaling
        self.decay = decay

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """λ as given and the σ whose stationary sd is ``scale`` in continuous time."""
        return {
            "torque.decay": from_torques(scale, self.decay),
            "torque.scale": scale * (2 * self.decay) ** 0.5,
        }

    def _factor(self, dt: Tensor, parameters: Parameters) -> Tensor:
        x = parameters["torque.decay"] * dt
        return torch.exp(-x) if self.scaling == "exact" else 1 - x

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """Decay towards zero, (..., K) N·m."""
        return self._factor(dt, parameters) * z

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Standard deviation of one step's torque noise, (..., K) N·m."""
        sigma = parameters["torque.scale"]
        if self.scaling == "printed":
            return dt * sigma
        if self.scaling == "wiener":
            return dt**0.5 * sigma
        decay = parameters["torque.decay"]
        return sigma * torch.sqrt(-torch.expm1(-2 * decay * dt) / (2 * decay))

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Stationary sd of the discrete chain, (..., K) N·m."""
        factor = self._factor(dt, parameters)
        return self.noise(dt, parameters) / torch.sqrt(1 - factor**2)


class RandomWalk(TorqueProcess):
    """τ_t = τ_{t−1} + noise: no pull to zero.

    Parameters: "torque.scale", σ as in the table above (``scaling`` "printed" or "wiener"),
    and "torque.initial_scale", the sd of τ_0 (N·m), as no stationary one exists.
    """

    def __init__(self, scaling: str = "wiener"):
        if scaling not in SCALINGS[:2]:
            raise ValueError(f"expected a noise scaling among {', '.join(SCALINGS[:2])}, got {scaling!r}")
        self.scaling = scaling

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """σ that moves the torque by ``scale`` in a fifth of a second."""
        return {"torque.scale": scale * 5**0.5, "torque.initial_scale": scale.clone()}

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """The torque itself, (..., K) N·m."""
        return z

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Standard deviation of one step's torque noise, (..., K) N·m."""
        return parameters["torque.scale"] * (dt if self.scaling == "printed" else dt**0.5)

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Initial sd, (..., K) N·m."""
        return parameters["torque.initial_scale"]
