"""The bootstrap guide: propose from the prior dynamics and let the weights see the data.

Gordon, Salmond & Smith (1993). q(x_t | x_{t−1}) = p(x_t | x_{t−1}), so log p/q = 0. The simplest
and the weakest: under Euler–Maruyama a torque moves the angle two rows later, and a proposal
blind to the future cannot steer it.
"""

import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.filters.proposal import Particles, Proposal, draw


class Bootstrap(Proposal):
    """Guide that proposes from the model itself; for another proposal, subclass :class:`.Proposal`."""

    def conditional_initial(self) -> Distribution:
        """p(x_0)."""
        return self.model.initial()

    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """p(x_t | x_{t−1})."""
        return self.model.transition(state, t)

    def propose_initial(self, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
        """Draw from the prior; the ratio is one."""
        x = draw(self.model.initial().expand(torch.Size(shape)))
        return self.at(0, x), x.new_zeros(shape)

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw from the dynamics; the ratio is one."""
        x = draw(self.model.transition(particles["x"], t))
        return self.at(t, x), x.new_zeros(x.shape[:-1])
