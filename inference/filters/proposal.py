"""What a guide is: where the next particles come from.

A proposal draws x_t and returns log p(x_t | x_{t−1}) − log q(x_t | x_{t−1}, y). It serves
:meth:`ParticleFilter.run` through ``propose_initial`` and ``propose``, and any Pyro algorithm
that wants a guide (``SMCFilter``) through ``init`` and ``step``.

A new guide is a subclass that gives ``conditional_initial`` and ``conditional``; it overrides
``propose`` only where a closed form is faster. A guide that looks ahead also gives ``log_twist``.
"""

from abc import ABC, abstractmethod

import pyro
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.state_space import StateSpaceModel

Particles = dict[str, Tensor]
"""Tensors (M, N, …) that are resampled together: "x" (M, N, D), and what a guide carries along."""


class Proposal(ABC):
    """A guide for a :class:`StateSpaceModel`."""

    def __init__(self, model: StateSpaceModel):
        self.model = model

    @abstractmethod
    def conditional_initial(self) -> Distribution:
        """q(x_0), event shape (D,)."""

    @abstractmethod
    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """q(x_t | x_{t−1} = state (..., D)), event shape (D,).

        ``t`` is an int; a compiled filter gives a LongTensor (1,), for rows that are neither first nor last.
        """

    def propose_initial(self, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
        """Draw x_0 of batch ``shape``; returns particles and log p(x_0)/q(x_0) of that shape."""
        proposal = self.conditional_initial().expand(torch.Size(shape))
        x = draw(proposal)
        return {"x": x}, self.model.initial().log_prob(x) - proposal.log_prob(x)

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw x_t given the particles of row t − 1; returns particles and log p/q."""
        proposal = self.conditional(t, particles["x"])
        x = draw(proposal)
        target = self.model.transition(particles["x"], t).log_prob(x)
        return {"x": x}, target - proposal.log_prob(x)

    def at(self, t: int | Tensor, x: Tensor) -> Particles:
        """All that is carried along with particles x_t = ``x`` (..., D)."""
        particles = {"x": x}
        if hasattr(self, "log_twist"):
            particles["log_twist"] = self.log_twist(particles, t)
        return particles

    # -- pyro.infer.SMCFilter ------------------------------------------------------------------
    def init(self, state: Particles, observation: Tensor | None = None) -> None:
        """First step of an ``SMCFilter`` guide."""
        pyro.sample("x_0", self.conditional_initial())

    def step(self, state: Particles, t: int, observation: Tensor | None = None) -> None:
        """Step into row ``t`` of an ``SMCFilter`` guide; reads ``state["x"]``."""
        pyro.sample(f"x_{t}", self.conditional(t, state["x"]))


def draw(distribution: Distribution) -> Tensor:
    """Draw values that carry no gradient.

    By ``rsample`` where there is one: ``sample`` of a Gaussian looks at its scales first, which waits for the device.
    """
    with torch.no_grad():
        return distribution.rsample() if distribution.has_rsample else distribution.sample()
