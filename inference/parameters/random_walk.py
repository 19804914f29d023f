"""Random-walk Metropolis with an estimated likelihood, on many walkers at once, and its adaptation.

    z' = z + s L ε,   ε ~ N(0, I),     accept with probability  min(1, p(z') L̂(z')^λ / (p(z) L̂(z)^λ))

With an unbiased L̂ whose random numbers are drawn again for each z', and the estimate at z kept from when it was
proposed, the chain leaves the exact posterior invariant (Andrieu & Roberts 2009, "The pseudo-marginal approach").

Adaptation (Andrieu & Thoms 2008, "A tutorial on adaptive MCMC", algorithm 4), with step sizes γ_i = (i + 1)^−.6:

    μ += γ (z̄ − μ),     Σ += γ (mean (z − μ)(z − μ)ᵀ − Σ),     log s += γ (acceptance − target)

It must end before draws are kept. Means are over C walkers of one group, so that L Lᵀ = Σ is that of their posterior.

Shapes: walkers (..., C, P), any number of groups before; μ (..., P), Σ (..., P, P), s (...).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

Evaluate = Callable[[Tensor], Tensor]
"""Log-likelihood (...) at z (..., P), or the logarithm of an unbiased estimate."""

RIDGE = 1e-6
"""Variance added to each coordinate of the unconstrained scale, so that Σ always has a square root."""


class Walkers(NamedTuple):
    """Walkers at z (..., P) with their log-prior and log-likelihood (...)."""

    z: Tensor
    log_prior: Tensor
    log_likelihood: Tensor


def metropolis(
    walkers: Walkers, root: Tensor, log_prior: Evaluate, log_likelihood: Evaluate, exponent: float | Tensor = 1.0
) -> tuple[Walkers, Tensor, Tensor]:
    """One step of each walker: the walkers after it, which of them moved (...), and acceptance probabilities (...).

    Args:
        walkers: at z (..., C, P).
        root: (..., P, P) square root of the step's covariance.
        log_prior, log_likelihood: evaluated at the proposals, −∞ where impossible.
        exponent: λ of the likelihood.
    """
    z = walkers.z + torch.randn_like(walkers.z) @ root.mT
    proposed = Walkers(z, log_prior(z), log_likelihood(z))
    ratio = proposed.log_prior - walkers.log_prior
    ratio = ratio + exponent * (proposed.log_likelihood - walkers.log_likelihood)
    # A walker at likelihood zero takes any proposal of positive likelihood; neither gives NaN, which stays.
    chance = ratio.nan_to_num(nan=-torch.inf, posinf=0.0).clamp(max=0.0).exp()
    moved = torch.rand_like(chance) < chance

    def chosen(new: Tensor, old: Tensor) -> Tensor:
        return torch.where(moved.reshape(*moved.shape, *[1] * (new.ndim - moved.ndim)), new, old)

    return Walkers(*map(chosen, proposed, walkers)), moved, chance


def step_root(covariance: Tensor, scale: float | Tensor = 1.0) -> Tensor:
    """Square root (..., P, P) of (2.38² / P) s² Σ (Roberts, Gelman & Gilks 1997), Σ (..., P, P), s (...)."""
    size = covariance.shape[-1]
    root = torch.linalg.cholesky(covariance + RIDGE * torch.eye(size, dtype=covariance.dtype))
    factor = torch.as_tensor(scale, dtype=covariance.dtype) * 2.38 / math.sqrt(size)
    return factor[..., None, None] * root


def weighted_moments(z: Tensor, log_weights: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (..., P) and covariance (..., P, P) of draws z (..., K, P) with log-weights (..., K)."""
    weights = torch.softmax(log_weights, -1).unsqueeze(-1)
    mean = (weights * z).sum(-2)
    centred = z - mean.unsqueeze(-2)
    return mean, (weights * centred).mT @ centred


class Adaptation:
    """Moments and scale of the step, learned from walkers z (..., C, P); see the top of the file.

    Args:
        z: walkers at the start.
        target: acceptance that the scale aims at.
    """

    def __init__(self, z: Tensor, target: float):
        self.target = target
        self.mean, self.covariance = weighted_moments(z, z.new_zeros(z.shape[:-1]))
        self.log_scale = z.new_zeros(z.shape[:-2])
        self._count = 0

    def update(self, z: Tensor, chance: Tensor) -> None:
        """Learn from walkers z (..., C, P) and their acceptance probabilities (..., C)."""
        self._count += 1
        rate = (self._count + 1) ** -0.6
        centred = z - self.mean.unsqueeze(-2)
        self.mean = self.mean + rate * centred.mean(-2)
        self.covariance = self.covariance + rate * (centred.mT @ centred / z.shape[-2] - self.covariance)
        self.log_scale = self.log_scale + rate * (chance.mean(-1) - self.target)

    def root(self) -> Tensor:
        """Square root (..., P, P) of the step's covariance."""
        return step_root(self.covariance, self.log_scale.exp())
