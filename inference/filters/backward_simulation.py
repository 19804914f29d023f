"""From filters to smoothed trajectories: p(x_{0:T} | y_{0:T}), what users see.

* :func:`genealogy`: follow each final particle's ancestors back. Exact, but after many
  resamplings all lines meet in one.
* :func:`backward_simulation`: Godsill, Doucet & West (2004), "Monte Carlo smoothing for nonlinear time
  series": draw x_{T−1}, then backwards

      i ~ Ŵ_t^i p(x_{t+1} | x_t^i),     Ŵ_t^i = W_t^i / ψ̃_t(x_t^i)   (the filter without its twist).

  When the dynamics are nearly deterministic, p(x_{t+1} | x_t^i) is zero but for x_{t+1}'s own
  parent, and the draws are no better than the genealogy. So each step is followed by a
  Metropolis–Hastings move of a whole block (Bunch & Godsill 2013; Lindsten et al. 2015): a new
  ancestor x_t^i and new states x_{t+1} … x_{t+ℓ} between it and the fixed x_{t+ℓ+1}, proposed by
  the same square-root recursion as the controlled guide, run from the fixed end (see
  :mod:`.bridge`). A torque takes two steps to reach the angle, so a single state cannot be moved, but
  a block of ℓ ≥ 3 can.

Shapes: M filters, N particles, R draws a filter, W kept rows; draws (M, R, W, D).
"""

from collections.abc import Callable

import torch
from torch import Tensor

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.bridge import Bridge
from invdyn.inference.filters.moment_matching import exact_closed_form
from invdyn.inference.filters.particles import FilterResult, take_at
from invdyn.inference.filters.resampling import categorical
from invdyn.inference.filters.weights import log_step
from invdyn.inference.preconditions import NO_DENSITY
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models.state_space import StateSpaceModel


def genealogy(result: FilterResult, num_draws: int) -> Tensor:
    """Ancestral lines (M, R, W, D) of R final particles a filter, drawn by weight."""
    index = categorical(result.log_weights[-1].unsqueeze(-2).expand(-1, num_draws, -1))
    lines = []
    for states, _, _, ancestors in result.backwards():
        lines.append(take_at(states, index))
        index = ancestors.long().gather(-1, index)
    return torch.stack(lines[::-1], -2)


@torch.no_grad()
def backward_simulation(
    model: StateSpaceModel,
    result: FilterResult,
    observations: Tensor,
    num_draws: int,
    *,
    smoother: GaussianSmoother | None = None,
    block: int = 6,
    progress: Callable[[int, int], None] | None = None,
    seed: int | None = None,
) -> Tensor:
    """Smoothed trajectories (M, R, W, D) of the rows that ``result`` kept.

    Args:
        model: the filtered model, with a transition density.
        result: of a run that kept the rows wanted.
        observations: (T, O); the last W rows belong to the kept states.
        num_draws: R trajectories a filter.
        smoother: Gauss–Newton result for the block moves, which need Gaussian dynamics with one covariance in all
            states; without it, or for other dynamics, plain backward simulation.
        block: ℓ, states moved at once.
        progress: called with (rows done, rows in all).
        seed: of these draws' random numbers; by default torch's own go on.

    Raises ModelError where the transition has no density, as with a state without noise: :func:`genealogy` needs none.
    """
    observations = check_model(model, observations, needs=("transition_density",))
    model, observations = in_double(model, observations, result)
    kept, bridge = result.rows, None
    if smoother is not None and kept > block + 2 and exact_closed_form(model, smoother.path):
        bridge = Bridge(model, observations, smoother, block)

    def step(k: int, t: int, states: Tensor, log_weights: Tensor, path: Tensor, _: Tensor) -> Tensor:
        reach = log_step(model, states.unsqueeze(-3), path[..., k + 1, :].unsqueeze(-2), observations[t], t)
        check_density(model, states, reach, t)
        index = categorical(log_weights.unsqueeze(-2) + reach)
        path[..., k, :] = take_at(states, index)
        # Every third row or so: a block covers ℓ states, so each is still moved twice.
        if bridge is not None and k % max(1, block // 2) == 0 and k + block + 1 < kept:
            stretch = path[..., k : k + block + 2, :]
            path[..., k : k + block + 1, :] = bridge.move(t - 1, states, log_weights, stretch)
        if progress is not None:
            progress(kept - k, kept)
        return index

    with seeded(seed, result.states.device):
        return walked_back(result, len(observations), num_draws, step)


Step = Callable[[int, int, Tensor, Tensor, Tensor, Tensor], Tensor]
"""From kept row k, the number t of the next one, states (M, N, D) and log-weights (M, N) of row k's untwisted filter,
paths (M, R, W, D) after it, to which it adds row k, and their particles (M, R) at row t, to those at row k."""


def in_double(model: StateSpaceModel, observations: Tensor, result: FilterResult) -> tuple[StateSpaceModel, Tensor]:
    """A model and its rows in float64, where the states of ``result`` are."""
    device = result.states.device
    return model.to(dtype=torch.float64, device=device), observations.to(dtype=torch.float64, device=device)


def walked_back(result: FilterResult, rows: int, num_draws: int, step: Step) -> Tensor:
    """Trajectories (M, R, W, D): final particles of ``result``, by weight, and before each what ``step`` draws."""
    states, kept = result.states, result.rows
    # Integers stay integers, by which a model may index.
    dtype = torch.float64 if states.is_floating_point() else states.dtype
    index = categorical(result.log_weights[-1].unsqueeze(-2).expand(-1, num_draws, -1))
    path = torch.empty(*index.shape, kept, states.shape[-1], dtype=dtype, device=states.device)
    path[..., kept - 1, :] = take_at(states[-1], index).to(dtype)
    for k, (here, weights, twist, _) in zip(range(kept - 1, -1, -1), result.backwards(), strict=True):
        if k < kept - 1:
            log_weights = weights.double() if twist is None else weights.double() - twist.double()
            index = step(k, rows - kept + k + 1, here.to(dtype), log_weights, path, index)
    return path


def check_density(model: StateSpaceModel, states: Tensor, reach: Tensor, t: int) -> None:
    """Raise ModelError for log-densities ``reach`` (M, R, N) that are no densities of finite ``states`` (M, N, D).

    A simulation may run away from a few of the states: NaN counts as zero where others have a density.
    """
    wrong = torch.isposinf(reach) | (torch.isnan(reach) & ~torch.isfinite(reach).any(-1, keepdim=True))
    if bool(wrong.any()) and bool((wrong & torch.isfinite(states).all(-1).unsqueeze(-2)).any()):
        raise ModelError(
            f"{type(model).__name__}.transition: expected a finite log-density in row {t}, got NaN or infinity, as "
            f"where a state has no noise: {NO_DENSITY}"
        )
