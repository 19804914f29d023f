"""Pyro's pair of model and guide as a state-space model and its proposal, parameters looked up and drawn."""

import copy
from typing import Any

import torch
from pyro import poutine
from torch import Tensor

from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.models.state_space import StateSpaceModel


def draw(guide: Proposal, t: int, particles: Particles, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
    """Row t's particles, differentiable in all parameters, and log p(x_t | x_{t−1})/q(x_t)."""
    if getattr(guide, "reparameterised", False):
        return guide.propose_initial(shape) if t == 0 else guide.propose(t, particles)
    if t == 0:
        before, proposal = guide.model.initial(), guide.conditional_initial().expand(torch.Size(shape))
    else:
        before, proposal = guide.model.transition(particles["x"], t), guide.conditional(t, particles["x"])
    if not proposal.has_rsample:
        raise TypeError(f"expected a guide with reparameterised draws (rsample), got {proposal} at row {t}")
    x = proposal.rsample()
    return guide.at(t, x), before.log_prob(x) - proposal.log_prob(x)


def state_space_model(model: Any) -> StateSpaceModel:
    """The model behind what SVI was given: itself, or the owner of its method ``sequence``; TypeError for others."""
    owner = getattr(model, "__self__", model)
    if not isinstance(owner, StateSpaceModel) or (owner is not model and model.__name__ != "sequence"):
        raise TypeError(f"expected a StateSpaceModel or its method sequence as SVI's model, got {model!r}")
    return owner


def drawn_latents(model: StateSpaceModel, guide: Proposal) -> tuple[dict[str, Tensor], Tensor | float]:
    """Values of the sites of parameters with priors, and log p(θ)/q(θ) of those that the guide draws."""
    draw = getattr(guide, "parameters", None)
    drawn = poutine.trace(draw).get_trace() if draw else poutine.Trace()
    trace = poutine.trace(poutine.replay(model.sampled, trace=drawn)).get_trace()
    latents = {name: trace.nodes[name]["value"] for name in trace.stochastic_nodes}
    if not draw:
        return latents, 0.0
    trace.compute_log_prob(lambda name, site: name in drawn.stochastic_nodes)
    ratio = sum(trace.nodes[name]["log_prob_sum"] for name in drawn.stochastic_nodes) - drawn.log_prob_sum()
    return latents, ratio


def bound_to(guide: Proposal, model: StateSpaceModel) -> Proposal:
    """The guide of this model, its own parameters looked up in Pyro's store."""
    if not isinstance(guide, Proposal):
        raise TypeError(f"expected a Proposal as SVI's guide, got {type(guide).__name__}")
    if hasattr(guide, "sampled"):
        return guide.sampled(model)
    guide = copy.copy(guide)
    guide.model = model
    return guide
