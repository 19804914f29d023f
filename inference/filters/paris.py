"""PaRIS: smoothed expectations of additive functionals, row by row, in memory that does not grow.

Olsson & Westerborn (2017), "Efficient particle-based online smoothing in general hidden Markov models: the PaRIS
algorithm", Bernoulli 23. Of h_{0:t} = h_0(x_0) + Σ_s h_s(x_{s−1}, x_s), each particle carries τ_t^i, an estimate of
E[h_{0:t} | x_t = x_t^i, y_{0:t}]:

    J_ij ~ B(· | x_t^i) ∝ W_{t−1} p(x_t^i | x_{t−1}),     j = 1 … Ñ,
    τ_t^i = (1/Ñ) Σ_j (τ_{t−1}^{J_ij} + h_t(x_{t−1}^{J_ij}, x_t^i)),
    E[h_{0:t} | y_{0:t}] ≈ Σ_i W_t^i τ_t^i.

Ñ = 2 is enough: with Ñ = 1 lines degenerate as in the genealogy, and the variance grows with t² instead of t. The J are
draws from B itself, at N² densities a row, or by Metropolis–Hastings from the genealogy's ancestor on, at (Ñ − 1) N of
them (Dau & Chopin 2023, "On backward smoothing algorithms"; :mod:`.backward_mcmc`).

An additive functional gives sums of smoothed means, moments and cross products, and with them the score and the steps
of EM; ``1{s = r} x_s`` gives one row's smoothed mean.

Shapes: M filters, N particles, values (M, N, …) with any dimensions of the functional's own.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.seeds import Stream, derived
from invdyn.inference.filters.backward_mcmc import move_ancestors
from invdyn.inference.filters.online import OnlineRow, filter_rows
from invdyn.inference.filters.particles import take_at
from invdyn.inference.filters.resampling import categorical
from invdyn.inference.filters.weights import log_step
from invdyn.models.state_space import StateSpaceModel


class Additive(Protocol):
    """One row's term of an additive functional."""

    def __call__(self, previous: Tensor | None, state: Tensor, t: int) -> Tensor:
        """h_t(x_{t−1}, x_t) of states (M, R, D) each, (M, R, …); ``previous`` is None at row 0."""
        ...


@dataclass(frozen=True)
class OnlineEstimate:
    """What is known after row t.

    Attributes:
        t: row number.
        value: (M, …) estimate of E[h_{0:t} | y_{0:t+1}] by each of M filters.
        log_evidence: (M,) log p̂(y_{0:t+1}).
        ess: (M,) effective sample size of the filter.
    """

    t: int
    value: Tensor
    log_evidence: Tensor
    ess: Tensor


def paris(
    model: StateSpaceModel,
    rows: Iterable[Tensor | np.ndarray],
    additive: Additive,
    num_particles: int,
    *,
    seed: int,
    backward_draws: int = 2,
    backward: Literal["mcmc", "exact"] = "mcmc",
    **filtering: Any,
) -> Iterator[OnlineEstimate]:
    """Yield an :class:`OnlineEstimate` for each of ``rows`` (O,), NaN where missing.

    Args:
        model: with a transition density.
        rows: observations as they come.
        additive: h_t, see the top of the file.
        num_particles: N.
        seed: of every random number.
        backward_draws: Ñ, at least 2.
        backward: "mcmc" or "exact", how ancestors are drawn.
        filtering: further options of :func:`filter_rows`.

    Raises ValueError for fewer than two backward draws or another way to draw them, and as :func:`filter_rows`.
    """
    if backward_draws < 2 or backward not in ("mcmc", "exact"):
        raise ValueError(
            f'expected two backward draws or more, by "mcmc" or "exact", got {backward_draws} by {backward!r}'
        )
    filtered = filter_rows(model, rows, num_particles, seed=derived(seed, 0), **filtering)
    stream = Stream(derived(seed, 1), model.device)
    return _estimates(model, filtered, additive, stream, backward_draws, exact=backward == "exact")


@torch.no_grad()
def _estimates(
    model: StateSpaceModel,
    filtered: Iterator[OnlineRow],
    additive: Additive,
    stream: Stream,
    draws: int,
    *,
    exact: bool,
) -> Iterator[OnlineEstimate]:
    carried = torch.empty(0)
    for row in filtered:
        if row.previous is None:
            carried = additive(None, row.states, row.t)
        else:
            with stream.drawing():
                ancestors = _exact(model, row, draws) if exact else _moved(model, row, draws)
            # One backward draw after another: (M, N, …) at a time, for any dimensions of h.
            terms = [_term(additive, row, row.previous.states, carried, index) for index in ancestors]
            carried = torch.stack(terms).mean(0)
        yield OnlineEstimate(row.t, row.mean(carried), row.log_evidence, row.ess)


def _term(additive: Additive, row: OnlineRow, before: Tensor, carried: Tensor, index: Tensor) -> Tensor:
    """τ_{t−1} + h_t (M, N, …) along one ancestor (M, N) of each particle."""
    kept = take_at(carried.flatten(2), index) if carried.ndim > 2 else carried.gather(-1, index)
    return kept.reshape(carried.shape) + additive(take_at(before, index), row.states, row.t)


def _moved(model: StateSpaceModel, row: OnlineRow, draws: int) -> list[Tensor]:
    """The genealogy's ancestors (M, N), and those after each further Metropolis–Hastings step."""
    before = _previous(row)
    found = [row.ancestors]
    for _ in range(draws - 1):
        found.append(
            move_ancestors(model, before.states, before.log_weights, found[-1], row.states, row.y, row.t, steps=1)
        )
    return found


def _exact(model: StateSpaceModel, row: OnlineRow, draws: int) -> list[Tensor]:
    """Independent ancestors (M, N) from the backward kernel."""
    before = _previous(row)
    reach = log_step(model, before.states.unsqueeze(-3), row.states.unsqueeze(-2), row.y, row.t)
    logits = before.log_weights.unsqueeze(-2) + reach
    return [categorical(logits) for _ in range(draws)]


def _previous(row: OnlineRow) -> OnlineRow:
    if row.previous is None:
        raise ValueError("expected a row with one before it, got row 0: its particles have no ancestors")
    return row.previous
