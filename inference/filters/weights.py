"""The arithmetic of particle weights, as functions without side effects: of filters and of their bound.

    log w = log W + increment,   total = log Σ_n w^n,   log W' = log w − total,   ESS = (Σ w)² / Σ w²

Shapes: N particles in the last dimension, any number of filters before it. Weights and totals are in float64
for any type of the states. Nothing here reads a value from the device, so that a row costs no wait.
"""

import math
from typing import NamedTuple

import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.filters.particles import take
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.filters.resampling import resample
from invdyn.models.observation.missing import observed_log_prob
from invdyn.models.state_space import StateSpaceModel


class Row(NamedTuple):
    """What a row leaves behind: weights (M, N), normalised; total and ESS (M,)."""

    particles: Particles
    log_weights: Tensor
    total: Tensor
    ess: Tensor


def advanced(
    model: StateSpaceModel,
    guide: Proposal,
    t: int | Tensor,
    y: Tensor | None,
    seen: Tensor | None,
    particles: Particles,
    log_weights: Tensor,
) -> Row:
    """Draw row t's particles and weigh them.

    t is a tensor (1,) in compiled rows, of which none is the first; y is None where nothing was seen, ``seen`` where
    all of it was.
    """
    first = isinstance(t, int) and t == 0
    drawn, increment = guide.propose_initial(tuple(log_weights.shape)) if first else guide.propose(t, particles)
    if y is not None:
        increment = increment + row_log_prob(model.row_emission(particles.get("x"), drawn["x"], t), y, seen)
    if "log_twist" in drawn:
        increment = increment + drawn["log_twist"] - particles.get("log_twist", 0.0)
    return Row(drawn, *normalised(log_weights, increment))


def resampled(need: Tensor, particles: Particles, log_weights: Tensor, scheme: str) -> tuple[Particles, Tensor, Tensor]:
    """The particles that go on, their log-weights and their ancestors (…, N); others where ``need`` (…) says so."""
    ancestors = ancestors_where(need, log_weights, scheme)
    log_weights = torch.where(need.unsqueeze(-1), -math.log(log_weights.shape[-1]), log_weights)
    return {name: take(value, ancestors) for name, value in particles.items()}, log_weights, ancestors


def normalised(log_weights: Tensor, increment: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Normalised log-weights (…, N) after ``increment`` (…, N), their total (…), the evidence's increment, and ESS (…).

    NaN in ``increment`` counts as weight zero. Where all weights are zero the total is −∞, the weights and ESS NaN.
    """
    log_weights = log_weights + increment.double()
    # A particle whose dynamics overflowed is out of reach of any data; it must not take its filter along.
    log_weights = torch.where(torch.isnan(log_weights), -torch.inf, log_weights)
    top = log_weights.detach().amax(-1, keepdim=True)
    top = torch.where(torch.isinf(top), 0.0, top)
    # One exponential serves the total and the ESS: at many particles it is a good part of a row.
    weights = torch.exp(log_weights - top)
    size = weights.sum(-1)
    total = size.log() + top.squeeze(-1)
    return log_weights - total.unsqueeze(-1), total, size.square() / weights.square().sum(-1)


def ancestors_where(need: Tensor, log_weights: Tensor, scheme: str) -> Tensor:
    """Ancestors (…, N), drawn from log-weights (…, N) in the filters that ``need`` (…) names, itself in the others."""
    identity = torch.arange(log_weights.shape[-1], device=log_weights.device)
    return torch.where(need.unsqueeze(-1), resample(log_weights, scheme), identity)


def row_log_prob(emission: Distribution, y: Tensor, seen: Tensor | None) -> Tensor:
    """Log p(y | x) over the entries of y (O,) that were ``seen`` (O,), None for all; of the emission's batch shape."""
    return emission.log_prob(y) if seen is None else observed_log_prob(emission, y, seen)


def log_step(model: StateSpaceModel, before: Tensor, after: Tensor, y: Tensor, t: int) -> Tensor:
    """All of log p(x_t, y_t | x_{t−1}) that depends on x_{t−1} = ``before`` (…, D), given x_t = ``after``; (…).

    It weighs ancestors: y_t (O,) counts only where the emission sees the state before.
    """
    value = model.transition(before, t).log_prob(after)
    if model.emission_sees_previous and not bool(y.isnan().all()):
        value = value + observed_log_prob(model.emission_given(before, after, t), y)
    return value
