"""Backward sampling at linear cost, by Metropolis–Hastings over ancestors.

Dau & Chopin (2023), "On backward smoothing algorithms", Annals of Statistics 51, algorithm 3 (the MCMC kernel).
Backward simulation draws the ancestor i of x_{t+1} with probability

    B(i | x_{t+1}) ∝ Ŵ_t^i p(x_{t+1} | x_t^i),     Ŵ_t^i = W_t^i / ψ̃_t(x_t^i)   (the filter without its twist),

which takes all N densities for each draw. Here a chain that leaves B invariant starts at the genealogy's own ancestor,
and makes a few steps: propose i' ~ Ŵ_t and accept with probability

    min(1, p(x_{t+1} | x_t^{i'}) / p(x_{t+1} | x_t^i)).

The start is already a draw from the filter's approximation, so that one or two steps are enough to part lines that
resampling joined, and the error stays O(1/N) for any number of rows. The cost is R K densities a row, not R N.

Where p(x_{t+1} | x_t) has no density (a state without noise) no proposal is accepted, and the draws are those of the
genealogy: right, and not more varied.

Shapes: M filters, N particles, R draws a filter, W kept rows; draws (M, R, W, D).
"""

import torch
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import in_double, walked_back
from invdyn.inference.filters.particles import FilterResult, take_at
from invdyn.inference.filters.weights import log_step
from invdyn.models.state_space import StateSpaceModel


@torch.no_grad()
def backward_mcmc(
    model: StateSpaceModel,
    result: FilterResult,
    observations: Tensor,
    num_draws: int,
    *,
    seed: int,
    steps: int = 2,
) -> Tensor:
    """Smoothed trajectories (M, R, W, D) of the rows that ``result`` kept; float64, or integers.

    Args:
        model: the filtered model.
        result: of a run that kept the rows wanted.
        observations: (T, O); the last W rows belong to the kept states.
        num_draws: R trajectories a filter.
        seed: of every random number.
        steps: K Metropolis–Hastings steps a row; with 0 the draws are the genealogy's.

    Raises ModelError for a model that does not fit the observations, and ValueError for no draw or a negative number
    of steps.
    """
    if num_draws < 1 or steps < 0:
        raise ValueError(f"expected at least one draw and no negative number of steps, got {num_draws} and {steps}")
    model, observations = in_double(model, check_model(model, observations), result)

    def step(k: int, t: int, states: Tensor, log_weights: Tensor, path: Tensor, index: Tensor) -> Tensor:
        ancestor = result.ancestors[k + 1].long().gather(-1, index)
        after = path[..., k + 1, :]
        index = move_ancestors(model, states, log_weights, ancestor, after, observations[t], t, steps)
        path[..., k, :] = take_at(states, index)
        return index

    with seeded(seed, result.states.device):
        return walked_back(result, len(observations), num_draws, step)


def move_ancestors(
    model: StateSpaceModel,
    states: Tensor,
    log_weights: Tensor,
    ancestor: Tensor,
    after: Tensor,
    y: Tensor,
    t: int,
    steps: int,
) -> Tensor:
    """Ancestors (M, R) of x_t = ``after`` (M, R, D) after ``steps`` independent Metropolis–Hastings steps.

    ``states`` (M, N, D) and ``log_weights`` (M, N) are row t − 1's untwisted filter, ``ancestor`` (M, R) the start and
    ``y`` (O,) row t's observation. Random numbers are torch's own.
    """
    if steps == 0:
        return ancestor
    weights = torch.softmax(log_weights.nan_to_num(nan=-torch.inf), -1)
    draws = ancestor.shape[-1]
    proposals = torch.multinomial(weights, steps * draws, replacement=True).reshape(len(states), steps, draws)

    current = _reach(model, take_at(states, ancestor), after, y, t)
    for proposed in proposals.unbind(1):
        reach = _reach(model, take_at(states, proposed), after, y, t)
        accept = torch.log(torch.rand_like(reach)) < reach - current
        ancestor = torch.where(accept, proposed, ancestor)
        current = torch.where(accept, reach, current)
    return ancestor


def _reach(model: StateSpaceModel, before: Tensor, after: Tensor, y: Tensor, t: int) -> Tensor:
    """Log-density (M, R) of the step; −∞ where there is none, so that a difference of two is never accepted."""
    return log_step(model, before, after, y, t).nan_to_num(nan=-torch.inf)
