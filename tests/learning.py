"""A short linear chain to learn on, and the slopes of a loss along its parameters."""

import pyro
import torch
from oracles import random_chain, with_gaps

GRADIENTS = ["dropped", "score", "stop-gradient"]
NAMES = ["transition", "transition_root", "emission_root", "guide.matrix", "guide.offset"]


def small(steps=4, dim=2, seed=1):
    """A short chain with correlated noises and gaps."""
    chain = random_chain(seed, dim=dim, size=1)
    y = with_gaps(chain.simulate(steps, seed)[1]) if steps > 6 else chain.simulate(steps, seed)[1]
    return chain, chain.model(steps), torch.as_tensor(y)


def step_along(loss, model, guide, y, names, seed=0):
    """The loss and its gradient in the unconstrained values of the named parameters."""
    torch.manual_seed(seed)
    value = loss.differentiable_loss(model.sequence, guide, y)
    leaves = [pyro.param(name).unconstrained() for name in names]
    return value.item(), torch.autograd.grad(value, leaves)


def shifted(loss, model, guide, y, name, direction, size, seed=0):
    """The loss with one parameter moved along a direction of its unconstrained space, same random numbers."""
    leaf = pyro.param(name).unconstrained()
    with torch.no_grad():
        leaf.add_(size * direction)
        torch.manual_seed(seed)
        value = loss.differentiable_loss(model.sequence, guide, y)
        leaf.sub_(size * direction)
    return value.item()


def disturb(guide, size=0.2):
    """Put a guide's parameters, in Pyro's store, off their start."""
    with torch.no_grad():
        guide.sampled(guide.model)
        for _, leaf in pyro.get_param_store().named_parameters():
            leaf.add_(size * torch.randn_like(leaf))
