"""A torque whose drift is a recurrent network; its hidden state is part of x.

    h_t = tanh(W h_{t−1} + U τ_{t−1}/s + b) + ρ ζ
    τ_t = (1 − λδ) τ_{t−1} + δ λ s V h_t-mean + √δ σ η

An Elman network driven by the torque it makes, the nonlinear prior that Biderman et al.
(2020) leave to future work. The small noise ρ on h keeps the transition density proper.
With V = 0 it is the Ornstein–Uhlenbeck process in "wiener" scaling.

Parameters: "torque.decay" λ (K,) 1/s, "torque.scale" σ (K,) N·m/√s, "torque.size" s (K,) N·m,
"torque.hidden_noise" ρ (H,), and the weights "torque.recurrent" W (H, H), "torque.input" U (H, K),
"torque.bias" b (H,), "torque.output" V (K, H).
"""

import torch
from torch import Tensor

from invdyn.models.shapes import apply, join
from invdyn.models.torques.base import Parameters, TorqueProcess, from_torques


class Recurrent(TorqueProcess):
    """Recurrent-network torque with ``hidden`` units; weights start at random from ``seed``."""

    unconstrained = frozenset({"torque.recurrent", "torque.input", "torque.bias", "torque.output"})

    def __init__(self, hidden: int = 4, decay: float = 5.0, seed: int = 0):
        self.hidden, self.decay, self.seed = hidden, decay, seed

    def size(self, num_joints: int) -> int:
        """Torques and hidden units."""
        return num_joints + self.hidden

    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """Random weights of a stable network, Ornstein–Uhlenbeck noise of stationary sd ``scale``."""
        joints, hidden = len(scale), self.hidden
        generator = torch.Generator().manual_seed(self.seed)

        def weights(*shape: int) -> Tensor:
            values = torch.randn(*shape, generator=generator, dtype=torch.float64) * 0.5 / shape[-1] ** 0.5
            return values.to(scale)

        return {
            "torque.decay": from_torques(scale, self.decay),
            "torque.scale": scale * (2 * self.decay) ** 0.5,
            "torque.size": scale.clone(),
            "torque.hidden_noise": torch.full((hidden,), 0.05).to(scale),
            "torque.recurrent": weights(hidden, hidden),
            "torque.input": weights(hidden, joints),
            "torque.bias": weights(hidden),
            "torque.output": weights(joints, hidden),
        }

    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """E[(τ, h)_t], (..., K + H)."""
        size, decay = parameters["torque.size"], parameters["torque.decay"]
        torque, hidden = z[..., : -self.hidden], z[..., -self.hidden :]
        drive = apply(parameters["torque.recurrent"], hidden)
        drive = drive + apply(parameters["torque.input"], torque / size)
        hidden = torch.tanh(drive + parameters["torque.bias"])
        pull = decay * dt
        torque = (1 - pull) * torque + pull * size * apply(parameters["torque.output"], hidden)
        return join(torque, hidden)

    def _sds(self, torque: Tensor, parameters: Parameters) -> Tensor:
        hidden = parameters["torque.hidden_noise"]
        return join(torque, hidden)

    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Standard deviations of one step's noise, (..., K + H)."""
        return self._sds(dt**0.5 * parameters["torque.scale"], parameters)

    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Of the torques as without the network, that is of the discrete chain; hidden units within ±1."""
        factor = 1 - parameters["torque.decay"] * dt
        torque = dt**0.5 * parameters["torque.scale"] / torch.sqrt(1 - factor**2)
        wide = {"torque.hidden_noise": torch.ones_like(parameters["torque.hidden_noise"])}
        return self._sds(torque, wide)
