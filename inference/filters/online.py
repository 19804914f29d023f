"""A particle filter that takes rows as they come, in memory that does not grow with their number.

Chopin & Papaspiliopoulos (2020), "An Introduction to Sequential Monte Carlo", algorithm 10.2: the same weights as
:meth:`ParticleFilter.run`, written as a generator. What a row leaves is handed on, and dropped when the next one comes;
methods that smooth on the way (:mod:`.paris`, :mod:`.fixed_lag`) carry along what they need of it.

Shapes: M filters, N particles each; a row (O,), NaN where missing.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.execution.seeds import Stream
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.filters.resampling import check_sizes
from invdyn.inference.filters.weights import advanced, resampled
from invdyn.models.state_space import StateSpaceModel


@dataclass(frozen=True)
class OnlineRow:
    """What the filter knows after row t.

    Attributes:
        t: row number.
        y: (O,) the row.
        states: (M, N, D) particles, before resampling.
        log_weights: (M, N) their normalised log-weights.
        ancestors: (M, N) each particle's parent, by its number at the row before; its own number at row 0.
        log_evidence: (M,) log p̂(y_{0:t+1}).
        ess: (M,) effective sample size.
        previous: the row before, whose own ``previous`` is None; None at row 0.
    """

    t: int
    y: Tensor
    states: Tensor
    log_weights: Tensor
    ancestors: Tensor
    log_evidence: Tensor
    ess: Tensor
    previous: "OnlineRow | None" = None

    def mean(self, values: Tensor) -> Tensor:
        """Weighted mean (M, …) of values (M, N, …) of the particles."""
        weights = self.log_weights.exp()
        return (weights.reshape(*weights.shape, *[1] * (values.ndim - 2)) * values).sum(1)


def filter_rows(
    model: StateSpaceModel,
    rows: Iterable[Tensor | np.ndarray],
    num_particles: int,
    *,
    seed: int,
    guide: Proposal | None = None,
    num_filters: int = 1,
    ess_threshold: float = 0.5,
    resampling: str = "systematic",
) -> Iterator[OnlineRow]:
    """Yield an :class:`OnlineRow` for each of ``rows``.

    Args:
        model: its number of rows sets no limit here.
        rows: (O,) each, NaN where missing; an iterator that waits for a sensor will do.
        num_particles: N.
        seed: of every random number.
        guide: without a twist, as nothing is known of the rows to come; :class:`Bootstrap` by default.
        num_filters: M.
        ess_threshold: resample a filter when its ESS falls below this share of N; in (0, 1].
        resampling: scheme, as for :class:`ParticleFilter`.

    Raises ModelError for a model that breaks its contract, or a row of another length; ValueError for no particle, a
    threshold outside its range or a guide with a twist; SMCFailed when all particles of a filter have weight zero.
    """
    guide = guide or Bootstrap(model)
    check_sizes(num_filters, num_particles, ess_threshold)
    if hasattr(guide, "log_twist"):
        raise ValueError(f"expected a guide without a twist, got {type(guide).__name__}: use Bootstrap")
    # Rows are still to come: those of a run in which nothing was seen stand for them.
    check_model(model, torch.full((model.num_steps, model.observation_dim), torch.nan))
    stream = Stream(seed, model.device)
    return _rows(model, guide, rows, (num_filters, num_particles), stream, ess_threshold, resampling)


@torch.no_grad()
def _rows(
    model: StateSpaceModel,
    guide: Proposal,
    rows: Iterable[Tensor | np.ndarray],
    shape: tuple[int, int],
    stream: Stream,
    ess_threshold: float,
    resampling: str,
) -> Iterator[OnlineRow]:
    filters, size = shape
    itself = torch.arange(size, device=model.device).expand(shape)
    log_weights = torch.full(shape, -math.log(size), dtype=torch.float64, device=model.device)
    log_evidence = log_weights.new_zeros(filters)
    particles: Particles = {}
    row: OnlineRow | None = None

    for t, y in enumerate(rows):
        y = _row(model, y, t)
        seen = ~y.isnan()
        entries = y if bool(seen.any()) else None, None if bool(seen.all()) else seen
        ancestors = itself
        with stream.drawing():
            if row is not None and bool((need := row.ess < ess_threshold * size).any()):
                particles, log_weights, ancestors = resampled(need, particles, log_weights, resampling)
            particles, log_weights, total, ess = advanced(model, guide, t, *entries, particles, log_weights)
        if not bool(torch.isfinite(total).all()):
            raise SMCFailed(
                f"expected a particle of positive weight, got none at row {t}: use more particles or wider noise"
            )
        log_evidence = log_evidence + total
        # One row back and no further: a chain of rows would grow with their number.
        before = None if row is None else replace(row, previous=None)
        row = OnlineRow(t, y, particles["x"], log_weights, ancestors, log_evidence, ess, before)
        yield row


def _row(model: StateSpaceModel, y: Tensor | np.ndarray, t: int) -> Tensor:
    """Row t (O,) in the model's type, on its device."""
    row = torch.as_tensor(y).to(dtype=model.dtype, device=model.device)
    if row.shape != (model.observation_dim,):
        raise ModelError(
            f"rows: expected row {t} of shape ({model.observation_dim},), got {tuple(row.shape)}: "
            "give one row at a time, NaN where missing"
        )
    return row
