"""Ornstein–Uhlenbeck torque, eq. 2 of Biderman et al. (2020), and its limit, the random walk.

    τ̇ = −λ τ + σ η      λ = "torque.decay" (1/s),  σ = "torque.scale"

How much noise one step of length δ carries is a choice, by name:

| scaling   | mean         | noise sd                     | unit of σ       |
|-----------|--------------|------------------------------|-----------------|
| "printed" | (1 − λδ) τ   | δ σ                          | N·m/s           |
| "wiener"  | (1 − λδ) τ   | √δ σ                         | N·m/√s          |
| "exact"   | e^(−λδ) τ    | σ √((1 − e^(−2λδ)) / (2λ))   | N·m/√s          |

A recording may begin in the middle of a motion: with ``underway`` the sd of τ_0 is larger than the stationary one, by
"torque.initial_scale" (N·m) in quadrature. Motors with a delay still follow, for a while, earlier commands.

By default λ = 5/s: torques of a limb or a robot change within a fifth of a second, for all gravities and lengths. So
this prior is not scale-free: for an arm that moves half as fast in a quarter of gravity, halve λ.

"printed" is the paper's covariance δ²σ²; its torque becomes smooth as δ → 0, so its σ belongs
to one frame rate. "wiener" is Euler–Maruyama with a true Wiener increment; "exact" is the
process itself, the right one for irregular or coarse sampling.
"""

import torch
from torch import Tensor

from invdyn.models.torques.base import Parameters, TorqueProcess, from_torques

SCALINGS = ("printed", "wiener", "exact")


class OrnsteinUhlenbeck(TorqueProcess):
    """Ornstein–Uhlenbeck torque; ``scaling`` is "printed", "wiener" or "exact" (default), ``underway`` as above."""

    def __init__(self, scaling: str = "exact", decay: float = 5.0, underway: bool = False):
        if scaling not in SCALINGS:
            raise ValueError(f"expected a noise scaling among {', '.join(SCALINGS)}, got {scaling!r}")
        self.scaling = scaling
        self.decay = decay
        self.underway = underway

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """λ as given and the σ whose stationary sd is ``scale`` in continuous time."""
        initial = {"torque.initial_scale": scale.clone()} if self.underway else {}
        return {
            "torque.decay": from_torques(scale, self.decay),
            "torque.scale": scale * (2 * self.decay) ** 0.5,
            **initial,
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
        """Sd of τ_0, (..., K) N·m: that of the discrete chain, and the uncertainty of the initial torque."""
        factor = self._factor(dt, parameters)
        known = self.noise(dt, parameters) / torch.sqrt(1 - factor**2)
        return torch.hypot(known, parameters["torque.initial_scale"]) if self.underway else known

    def unsettled(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Sd (..., K), N·m, of the step noise that keeps the uncertainty of the initial torque constant."""
        return parameters["torque.initial_scale"] * torch.sqrt(1 - self._factor(dt, parameters) ** 2)


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
