"""The base class of torque processes: a Gaussian Markov chain z_t whose first K entries are the joint torques.

    z_t = m(z_{t−1}, δ) + noise of square-root covariance L(δ),   τ_t = z_t[:K]

Shapes: z (..., Z), torque (..., K), δ broadcastable against (..., Z) (seconds); parameters
(..., K) under their dotted names, leading dims as in :class:`StateSpaceModel`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor

Parameters = Mapping[str, Tensor]


class TorqueProcess(ABC):
    """A prior on joint torques. Subclasses state which parameters they read and in which unit."""

    diagonal: bool = True
    """Whether :meth:`noise` gives standard deviations (..., Z) or a triangular square root (..., Z, Z)."""
    underway: bool = False
    """Whether a recording begins in the middle of a motion."""
    torques_suffice: bool = False
    """Whether z is linear and Gaussian, and all that rows tell of it they tell by the torques."""
    unconstrained: frozenset[str] = frozenset()
    """Parameters that may be negative (all others are positive)."""

    def __repr__(self) -> str:
        """Its kind and its numbers, the same in every process: a checkpoint knows by it which prior it has."""
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"

    def size(self, num_joints: int) -> int:
        """Entries of z for this many joints."""
        return num_joints

    @abstractmethod
    def defaults(self, scale: Tensor) -> dict[str, Tensor]:
        """Starting parameters for torques whose typical size is ``scale`` (K,), N·m."""

    @abstractmethod
    def mean(self, z: Tensor, dt: Tensor, parameters: Parameters) -> Tensor:
        """E[z_t | z_{t−1} = z], shape (..., Z), after ``dt`` seconds."""

    @abstractmethod
    def noise(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Square root of the transition covariance over ``dt`` seconds."""

    @abstractmethod
    def stationary(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Square root of the covariance of z_0, in the form of :meth:`noise`."""

    def unsettled(self, dt: Tensor, parameters: Parameters) -> Tensor:
        """Of a process that is ``underway``, sd (..., K), N·m: see :meth:`.OrnsteinUhlenbeck.unsettled`."""
        raise NotImplementedError(f"{type(self).__name__} has no motion before a recording begins")

    def path(self, torque: Tensor, time: Tensor) -> Tensor:
        """A plausible z path (T, Z) whose torques are ``torque`` (T, K): a start for linearisation."""
        z = torque.new_zeros(len(torque), self.size(torque.shape[-1]))
        z[:, : torque.shape[-1]] = torque
        return z


def from_torques(scale: Tensor, value: float) -> Tensor:
    """A constant parameter of the same shape and type as ``scale``."""
    return torch.full_like(scale, value)
