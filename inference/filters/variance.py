"""The variance of a filter's log-evidence from a single run, by who descends from whom.

Lee & Whiteley (2018), "Variance estimation in the particle filter", Biometrika 105; Chan & Lai (2013), "A general
theory of particle filters in hidden Markov models"; Olsson & Douc (2019), "Numerically stable online estimation of
variance in particle filters", Bernoulli 25. Let E^i be the number of particle i's ancestor at row 0 (its Eve). By
linearisation log Ẑ − log Z ≈ Σ_t e_t with

    e_t = Σ_i f_t^i,     f_t^i = W_t^i − W'_{t−1}^i     (W' the weights with which row t's particles were drawn),
    Var(log Ẑ) ≈ N/(N − 1) Σ_k (Σ_t Σ_{i: E_t^i = k} f_t^i)².

Without resampling it is the sample variance of the weights, and adaptive resampling counts as it happened. Rows at
which all particles have one Eve add nothing, so that it comes out too small for many rows.

The lagged estimate looks λ rows back instead: Cov(e_s, e_t) of rows s ≤ t ≤ s + λ is
Σ_k (Σ_{i: a(i) = k} f_s^i) (Σ_{i: a(i) = k} f_t^i), where a(i) is the ancestor at row s − λ. Rows farther apart are
taken for independent: a bias that falls geometrically with λ where the model forgets its past, and a variance that
does not grow with T. A few times the model's memory is a good λ.

Lee and Whiteley's unbiased form, 1 − (N/(N − 1))^{r+1} (1 − Σ_k m_k²) after r resamplings, with the Eves' masses m,
subtracts the noise of multinomial resampling; under systematic resampling, which has less, it is often negative. The
sums of f hold no such noise, and serve all schemes. A guide's twist belongs to the weights.

Shapes: M filters, N particles, T rows, all of them kept.
"""

import torch
from torch import Tensor

from invdyn.inference.filters.particles import FilterResult


def log_evidence_variance(result: FilterResult, *, lag: int | None = None) -> Tensor:
    """Estimated variance (M,) of each filter's log Ẑ.

    Args:
        result: of a run that kept all rows, with at least two particles.
        lag: λ in rows; None looks back to row 0.

    Raises ValueError for a single particle, a negative lag, or a run that dropped rows.
    """
    _check(result, lag)
    size = result.states.shape[2]
    total = _from_row_zero(result) if lag is None else _lagged(result, lag)
    return size / (size - 1) * total


def _from_row_zero(result: FilterResult) -> Tensor:
    differences = _differences(result)
    ancestors = _ancestors(result, 0, 0)
    total = _mass(differences[0], ancestors)
    for t in range(1, len(differences)):
        # One row on, each particle has the Eve of its parent.
        ancestors = ancestors.gather(-1, result.ancestors[t].long())
        total = total + _mass(differences[t], ancestors)
    return total.square().sum(-1)


def _lagged(result: FilterResult, lag: int) -> Tensor:
    differences = _differences(result)
    total = torch.zeros_like(result.log_evidence)
    for s, own_differences in enumerate(differences):
        ancestors = _ancestors(result, s, max(s - lag, 0))
        own = _mass(own_differences, ancestors)
        total = total + own.square().sum(-1)
        for t in range(s + 1, min(s + lag, len(differences) - 1) + 1):
            ancestors = ancestors.gather(-1, result.ancestors[t].long())
            total = total + 2 * (own * _mass(differences[t], ancestors)).sum(-1)
    return total


def _differences(result: FilterResult) -> list[Tensor]:
    """f_t (M, N) of each row."""
    log_weights = result.log_weights.double()
    return [weights.exp() - _drawn_with(result, log_weights, t) for t, weights in enumerate(log_weights)]


def _drawn_with(result: FilterResult, log_weights: Tensor, t: int) -> Tensor:
    """Weights (M, N) of row t's particles before they met y_t: uniform after resampling, else those of row t − 1."""
    uniform = torch.full_like(log_weights[t], 1 / log_weights.shape[-1])
    if t == 0:
        return uniform
    return torch.where(result.resampled[t - 1].unsqueeze(-1), uniform, log_weights[t - 1].exp())


def _ancestors(result: FilterResult, row: int, base: int) -> Tensor:
    """Number (M, N), at row ``base``, of the ancestor of each particle of ``row``."""
    size = result.states.shape[2]
    index = torch.arange(size, device=result.states.device).expand(result.states.shape[1], size)
    for t in range(row, base, -1):
        index = result.ancestors[t].long().gather(-1, index)
    return index


def _mass(values: Tensor, labels: Tensor) -> Tensor:
    """Sums (M, N) of values (M, N) by label 0 … N − 1."""
    return torch.zeros_like(values).scatter_add_(-1, labels, values)


def _check(result: FilterResult, lag: int | None) -> None:
    kept, size = len(result.states), result.states.shape[2] if result.states.ndim > 2 else 0
    if kept != len(result.ess):
        raise ValueError(f"expected a run that kept all {len(result.ess)} rows, got {kept}: leave out keep=")
    if size < 2:
        raise ValueError(f"expected at least two particles, got {size}: the variance is that between them")
    if lag is not None and lag < 0:
        raise ValueError(f"expected a lag of 0 rows or more, got {lag}")
