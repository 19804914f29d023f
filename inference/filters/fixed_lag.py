"""Fixed-lag smoothing: states given L further rows, as these come, in memory that does not grow.

Kitagawa & Sato (2001), "Monte Carlo smoothing and self-organising state-space model"; Olsson, Cappé, Douc & Moulines
(2008), "Sequential Monte Carlo smoothing with application to parameter estimation in nonlinear state-space models".
Each particle carries its last L states, which are resampled along with it, and

    E[φ(x_{t−L}) | y_{0:t+1}] ≈ Σ_i W_t^i φ(x_{t−L}^i),     x_{t−L}^i the ancestor of particle i,

stands in for E[φ(x_{t−L}) | y]. What later rows would change is missing: a bias that falls geometrically with L where
the model forgets its past. The genealogy of L rows has hardly degenerated, so that the variance does not grow with T.

Shapes: M filters, N particles.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.filters.online import OnlineRow, filter_rows
from invdyn.inference.filters.particles import take
from invdyn.models.state_space import StateSpaceModel


@dataclass(frozen=True)
class LaggedRow:
    """Row t given the rows up to t + L, or up to the last one.

    Attributes:
        t: row number.
        last: number of the last row that it accounts for.
        states: (M, N, D) the particles' states at row t.
        log_weights: (M, N) normalised log-weights, of row ``last``.
        log_evidence: (M,) log p̂(y_{0:last+1}).
    """

    t: int
    last: int
    states: Tensor
    log_weights: Tensor
    log_evidence: Tensor

    @property
    def mean(self) -> Tensor:
        """E[x_t | y_{0:last+1}], (M, D)."""
        return (self.log_weights.exp().unsqueeze(-1) * self.states).sum(-2)

    @property
    def variance(self) -> Tensor:
        """Variances of x_t given y_{0:last+1}, (M, D)."""
        off = self.states - self.mean.unsqueeze(-2)
        return (self.log_weights.exp().unsqueeze(-1) * off.square()).sum(-2)


def fixed_lag(
    model: StateSpaceModel,
    rows: Iterable[Tensor | np.ndarray],
    num_particles: int,
    *,
    lag: int,
    seed: int,
    **filtering: Any,
) -> Iterator[LaggedRow]:
    """Yield row 0, 1, … as a :class:`LaggedRow`, each ``lag`` rows after it came; the last ones at the end.

    Args:
        model: no density of its transition is needed with the bootstrap guide.
        rows: (O,) each, NaN where missing.
        num_particles: N.
        lag: L, in rows; 0 is the filter.
        seed: of every random number.
        filtering: further options of :func:`filter_rows`.

    Raises ValueError for a negative lag, and as :func:`filter_rows`.
    """
    if lag < 0:
        raise ValueError(f"expected a lag of 0 rows or more, got {lag}")
    return _lagged(filter_rows(model, rows, num_particles, seed=seed, **filtering), lag)


@torch.no_grad()
def _lagged(filtered: Iterator[OnlineRow], lag: int) -> Iterator[LaggedRow]:
    window: deque[Tensor] = deque()
    itself: Tensor | None = None
    row: OnlineRow | None = None
    for row in filtered:
        if itself is None:
            itself = row.ancestors
        elif row.ancestors is not itself and not torch.equal(row.ancestors, itself):
            window = deque(take(states, row.ancestors) for states in window)
        window.append(row.states)
        if len(window) > lag:
            yield _of(row, row.t - lag, window.popleft())

    # No row is to come: what remains accounts for all of them.
    while row is not None and window:
        yield _of(row, row.t + 1 - len(window), window.popleft())


def _of(row: OnlineRow, t: int, states: Tensor) -> LaggedRow:
    return LaggedRow(t, row.t, states, row.log_weights, row.log_evidence)
