"""What a state of an articulated body is made of, and its Gaussian law.

    x = (z, hidden states of effects, of sensors, θ, θ̇),     x ~ N(mean, diag(L Lᵀ, sds²))

z is the torque process's state, L the square root of its covariance or, where that is diagonal, its deviations.
Shapes: z (..., Z), hidden (..., H), sensors' memory (..., M), joints (..., K), states (..., D), D = Z + H + M + 2 K.
"""

from dataclasses import dataclass

import torch
from pyro.distributions import Distribution, Normal
from torch import Tensor

from invdyn.models.gaussian import by_root
from invdyn.models.shapes import common, join


@dataclass(frozen=True)
class StateLayout:
    """Z, H and K, whether the torque process's noise is ``diagonal``, and M."""

    torque: int
    hidden: int
    joints: int
    diagonal: bool
    memory: int = 0

    @property
    def size(self) -> int:
        """D."""
        return self.unseen + 2 * self.joints

    @property
    def unseen(self) -> int:
        """Z + H + M: what is before the angles."""
        return self.torque + self.hidden + self.memory

    def split(self, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """State (..., D) → all before the angles (..., Z + H + M), angles (..., K), velocities (..., K)."""
        z, angle, velocity = torch.split(state, [self.unseen, self.joints, self.joints], -1)
        return z, angle, velocity

    def parted(self, unseen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What is before the angles → torque state (..., Z), effects' hidden states (..., H), sensors' (..., M)."""
        z, hidden, memory = torch.split(unseen, [self.torque, self.hidden, self.memory], -1)
        return z, hidden, memory

    def at_rest(self, angle: Tensor, velocity: Tensor) -> Tensor:
        """The state (..., D) in which the torque process and all hidden states are zero."""
        still = angle.new_zeros(*common(angle.shape[:-1], velocity.shape[:-1]), self.unseen)
        return join(still, angle, velocity)

    def gaussian(self, mean: Tensor, root: Tensor, sds: Tensor) -> Distribution:
        """The law of states with this mean (..., D), L of z and deviations (..., H + M + 2 K) of the rest."""
        return gaussian(mean, root, sds, self.diagonal)

    def one_or_other(self, which: Tensor, one: Distribution, other: Distribution) -> Distribution:
        """The law ``one`` where ``which`` (...) says so, else the ``other``, both of :meth:`gaussian`."""
        here = which.unsqueeze(-1)
        if self.diagonal:
            loc, scale = (
                torch.where(here, getattr(one.base_dist, name), getattr(other.base_dist, name))
                for name in ("loc", "scale")
            )
            return Normal(loc, scale, validate_args=False).to_event(1)
        tril = torch.where(here.unsqueeze(-1), one.scale_tril, other.scale_tril)
        return by_root(torch.where(here, one.loc, other.loc), tril)


def gaussian(mean: Tensor, root: Tensor, sds: Tensor, diagonal: bool) -> Distribution:
    """N(mean, diag(L Lᵀ, sds²)) of states (..., D), with L (..., Z, Z), or, where that is ``diagonal``, (..., Z)."""
    if diagonal:
        return Normal(mean, join(root, sds), validate_args=False).to_event(1)
    size, first = mean.shape[-1], root.shape[-1]
    tril = mean.new_zeros(*common(root.shape[:-2], sds.shape[:-1]), size, size)
    tril[..., :first, :first] = root
    tril.diagonal(dim1=-2, dim2=-1)[..., first:] = sds
    return by_root(mean, tril)
