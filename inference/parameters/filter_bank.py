"""A bank of particle filters, one for each of M parameter sets, that advances row by row.

    log w_t = log W_{t−1} + log p(x_t | x_{t−1})/q(x_t) + log g(y_t | x_t),     log Ẑ += log Σ_n w_t^n

as in :mod:`.particle_filter`, of which these are the steps between rows that SMC² needs: filters are copied, exchanged
and restarted between two rows. A parameter set that gives the observations no density has log Ẑ = −∞ and is no error.
E[Ẑ(θ)] = p(y | θ) for each set and any number of particles (Del Moral 2004, prop. 7.4.1).

Shapes: M filters × N particles, states (M, N, D); rows (T, O), or (T, M, 1, O) where each filter has its own.
"""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.filters.resampling import categorical
from invdyn.inference.filters.weights import advanced, resampled
from invdyn.inference.parameters.unconstrained import unvalidated
from invdyn.models.state_space import StateSpaceModel

GuideOf = Callable[[StateSpaceModel], Proposal]
"""Makes the guide of a model with many parameter sets; :class:`.Bootstrap` by default."""


class FilterBank:
    """M filters of N particles each.

    Args:
        num_filters: M.
        num_particles: N.
        ess_threshold: share of N under which a filter is resampled before the next row.
        keep: whether states and ancestors of all rows are kept, from which :meth:`draw_paths` takes trajectories.

    Attributes:
        log_evidence: (M,) log p̂(y_{0:t} | θ) of the rows so far.
        row: number of rows so far.
    """

    def __init__(self, num_filters: int, num_particles: int, *, ess_threshold: float = 0.5, keep: bool = True):
        self.num_particles, self.ess_threshold, self.keep = num_particles, ess_threshold, keep
        self.log_evidence = torch.zeros(num_filters, dtype=torch.float64)
        self.row = 0
        self._log_weights = torch.full((num_filters, num_particles), -math.log(num_particles), dtype=torch.float64)
        self._ess = self.log_evidence.new_full((num_filters,), num_particles)
        self._particles: Particles = {}
        self._states: list[Tensor] = []
        self._parents: list[Tensor] = []

    @torch.no_grad()
    def advance(self, guide: Proposal, y: Tensor) -> Tensor:
        """Enter the next row; returns log p̂(y_t | y_{0:t−1}, θ) (M,), −∞ where no particle fits.

        Args:
            guide: of the model at the bank's M parameter sets.
            y: (O,), NaN where missing, or (M, 1, O), complete.
        """
        parents = torch.arange(self.num_particles).expand(self._log_weights.shape)
        need = self._ess < self.ess_threshold * self.num_particles
        seen = ~torch.isnan(y)
        with unvalidated():
            if self.row > 0 and bool(need.any()):
                found = resampled(need, self._particles, self._log_weights, "systematic")
                self._particles, self._log_weights, parents = found
            entries = y if bool(seen.any()) else None, None if bool(seen.all()) else seen
            row = advanced(guide.model, guide, self.row, *entries, self._particles, self._log_weights)
        self._particles, self._log_weights, total, self._ess = row
        self.log_evidence = self.log_evidence + total
        self.row += 1
        if self.keep:
            self._states.append(row.particles["x"])
            self._parents.append(parents)
        return total

    def select(self, index: Tensor) -> None:
        """Replace the filters by copies of those at ``index`` (M,)."""
        self._map(lambda value: value[index])

    def exchange(self, accept: Tensor, other: "FilterBank") -> None:
        """Take the filters of ``other``, with as many rows and particles, where ``accept`` (M,) is true."""
        theirs = iter(other._tensors())
        self._map(lambda mine: torch.where(accept.reshape(-1, *[1] * (mine.ndim - 1)), next(theirs), mine))

    def draw_paths(self) -> Tensor:
        """One trajectory (M, T, D) of each filter: the ancestral line of a particle of the last row, by weight."""
        index = categorical(self._log_weights)
        filters, line = torch.arange(len(index)), []
        for states, parents in zip(self._states[::-1], self._parents[::-1], strict=True):
            line.append(states[filters, index])
            index = parents[filters, index]
        return torch.stack(line[::-1], -2)

    def _tensors(self) -> list[Tensor]:
        """All tensors of the bank, in one order; the filters are their first dimension."""
        own = [self.log_evidence, self._log_weights, self._ess]
        return [*own, *self._particles.values(), *self._states, *self._parents]

    def _map(self, change: Callable[[Tensor], Tensor]) -> None:
        own = (self.log_evidence, self._log_weights, self._ess)
        self.log_evidence, self._log_weights, self._ess = map(change, own)
        self._particles = {name: change(value) for name, value in self._particles.items()}
        self._states = [change(value) for value in self._states]
        self._parents = [change(value) for value in self._parents]


def run_bank(
    model: StateSpaceModel,
    rows: Sequence[Tensor] | Tensor,
    num_filters: int,
    num_particles: int,
    *,
    guide: GuideOf = Bootstrap,
    keep: bool = False,
) -> FilterBank:
    """The bank of a model with ``num_filters`` parameter sets after all ``rows``."""
    bank = FilterBank(num_filters, num_particles, keep=keep)
    proposal = guide(model)
    for y in rows:
        bank.advance(proposal, y)
    return bank
