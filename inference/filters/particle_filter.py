"""Particle filters: many at once, with the evidence, as a subclass of Pyro's ``SMCFilter``.

Chopin & Papaspiliopoulos (2020), algorithm 10.2 (guided particle filter with adaptive
resampling), extended by a twist (Heng et al. 2020): a guide may state log ψ̃_t(x_t), how well x_t
fits what is yet to come, and the filter then targets p(x_{0:t} | y_{0:t}) ψ̃_t(x_t):

    log w_t = log W_{t−1} + log p(x_t | x_{t−1}) / q(x_t) + log g(y_t | x_t) + log ψ̃_t(x_t) − log ψ̃_{t−1}(x_{t−1})
    log Ẑ  += log Σ_n w_t^n ,   W_t = w_t / Σ w_t ,   resample when 1/Σ W² < threshold · N

ψ̃_T = 1, so the evidence is unbiased, E[Ẑ] = Z, for any guide and any times of resampling.

Two ways in, one set of weights:

* ``init(…)``/``step(…)``: any Pyro model and guide pair, as with :class:`pyro.infer.SMCFilter`
  (which drops the evidence and the ancestors and runs one filter only);
* ``run(observations)``: a :class:`StateSpaceModel` and a :class:`Proposal`, without the
  bookkeeping of Pyro traces.

Shapes: M filters × N particles in one tensor (M, N, …); with ``num_filters=None`` one filter of
plain Pyro shapes (N, …).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pyro
import torch
from pyro import poutine
from pyro.infer import SMCFilter
from pyro.infer.smcfilter import SMCFailed
from pyro.poutine.util import prune_subsample_sites
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.compiled import CompiledRows
from invdyn.inference.filters.particles import FilterResult, FilterState, History
from invdyn.inference.filters.proposal import Particles, Proposal, PyroSteps
from invdyn.inference.filters.resampling import check_sizes
from invdyn.inference.filters.weights import Row, advanced, normalised, resampled
from invdyn.inference.filters.windows import in_windows, window_rows
from invdyn.models.divergence import ran_away

PATIENCE = 1000
"""Rows after which a filter that must not wait for its device looks whether it is still alive."""

_TWIST = object()
"""Key next to those of Pyro's state, of which none can be the same."""


class ParticleFilter(SMCFilter):
    """M particle filters of N particles each.

    Args:
        model, guide: Pyro objects with ``init`` and ``step``, or a :class:`StateSpaceModel` and a
            :class:`Proposal`.
        num_particles: N.
        max_plate_nesting: as in Pyro; 0 for state-space models.
        num_filters: M, or None for one filter of Pyro's own shapes.
        ess_threshold: resample a filter when its ESS falls below this share of N; in (0, 1].
        resampling: "systematic", "stratified", "residual" or "multinomial".
        compiled: whether :meth:`run` compiles its rows (:mod:`.compiled`), which takes 5 to 10 s before the
            first; same numbers but for rounding, which can turn an ancestor. What cannot be compiled runs as it is,
            after one warning. The first and the last row always do.

    After each row: ``log_evidence`` (M,), ``ess`` (M,) before and ``resampled`` (M,) whether there was resampling,
    ``ancestors`` (M, N) of the particles that go on, and ``row``, the number of rows seen.
    """

    def __init__(
        self,
        model: PyroSteps,
        guide: PyroSteps,
        num_particles: int,
        max_plate_nesting: int = 0,
        *,
        num_filters: int | None = None,
        ess_threshold: float = 0.5,
        resampling: str = "systematic",
        compiled: bool = False,
    ):
        check_sizes(1 if num_filters is None else num_filters, num_particles, ess_threshold)
        super().__init__(model, guide, num_particles, max_plate_nesting, ess_threshold=ess_threshold)
        self.num_filters = num_filters
        self.resampling = resampling
        self.compiled = compiled
        self._rows = CompiledRows(lambda *row: advanced(self.model, self.guide, *row))
        self.batch = (num_particles,) if num_filters is None else (num_filters, num_particles)
        self.state = FilterState(self.batch)
        self._restart()

    def _restart(self, device: torch.device | str = "cpu") -> None:
        # float64 for weights and evidence, for any type of the states.
        uniform = -math.log(self.num_particles)
        self._log_weights = torch.full(self.batch, uniform, dtype=torch.float64, device=device)
        self.log_evidence = self._log_weights.new_zeros(self.batch[:-1])
        self.ancestors = self._itself = torch.arange(self.num_particles, device=device).expand(self.batch)
        self.row = 0
        self._log_twist: Tensor | None = None

    # -- Pyro's way in -------------------------------------------------------------------------
    def init(self, *args: Any, **kwargs: Any) -> None:
        """Sample row 0 and weight it; arguments go to the model and the guide."""
        self._restart()
        self.state = FilterState(self.batch)
        self._traced("init", args, kwargs)

    def step(self, *args: Any, **kwargs: Any) -> None:
        """Sample the next row and weight it; arguments go to the model and the guide."""
        self._traced("step", args, kwargs)

    def _plates(self) -> list[Any]:
        """Particle plate, inside a filter plate where there are several filters."""
        dim = -1 - self.max_plate_nesting
        particles = pyro.plate("particles", self.num_particles, dim=dim)
        if self.num_filters is None:
            return [particles]
        return [pyro.plate("filters", self.num_filters, dim=dim - 1), particles]

    def _traced(self, method: str, args: tuple, kwargs: dict[str, Any]) -> None:
        plates = self._plates()

        def in_plates(function: Callable) -> Callable:
            for plate in reversed(plates):
                function = plate(function)
            return function

        with poutine.block():
            with self.state._lock():
                guide = in_plates(getattr(self.guide, method))
                guide_trace = poutine.trace(guide).get_trace(self.state, *args, **kwargs)
            model = poutine.replay(in_plates(getattr(self.model, method)), guide_trace)
            model_trace = poutine.trace(model).get_trace(self.state, *args, **kwargs)
        increment = self._trace_log_weight(model_trace, guide_trace)
        if (twist := self._twist()) is not None:
            increment = increment + twist - (0.0 if self._log_twist is None else self._log_twist)
            self._log_twist = twist
        self._weigh(increment)
        whole = dict(self.state) | ({} if self._log_twist is None else {_TWIST: self._log_twist})
        carried: dict[str, Any] = self._resample(whole, synchronous=self.ess.device.type == "cpu")
        self._log_twist = carried.pop(_TWIST, None)  # type: ignore[call-overload]  # a key that no state has
        self.state._replace(carried, self._log_weights)

    def _twist(self) -> Tensor | None:
        """Log ψ̃ of this row's particles, by a guide that looks ahead."""
        if isinstance(self.guide, Proposal):
            return self.guide.at(self.row, self.state["x"]).get("log_twist")
        return self.guide.log_twist(self.state, self.row) if hasattr(self.guide, "log_twist") else None

    def _trace_log_weight(self, model_trace: Any, guide_trace: Any) -> Tensor:
        """Log p(x, y) − log q(x) per particle, from the traces of one step."""
        model_trace, guide_trace = prune_subsample_sites(model_trace), prune_subsample_sites(guide_trace)
        model_trace.compute_log_prob()
        guide_trace.compute_log_prob()

        def per_particle(log_prob: Tensor) -> Tensor:
            return (
                log_prob.expand(*self.batch, *log_prob.shape[len(self.batch) :])
                .flatten(len(self.batch) - 1, -1)
                .unflatten(-1, (self.num_particles, -1))
                .sum(-1)
            )

        terms = []
        for name, site in guide_trace.nodes.items():
            if site["type"] == "sample" and not site["is_observed"]:
                target = model_trace.nodes[name]["log_prob"]
                terms += [per_particle(target), -per_particle(site["log_prob"])]
        for site in model_trace.nodes.values():
            # A latent site that the guide leaves out was drawn from the model itself: its ratio is one.
            if site["type"] == "sample" and site["is_observed"]:
                terms.append(per_particle(site["log_prob"]))
        return sum(terms, start=torch.zeros(())).expand(self.batch)

    # -- the fast way in -----------------------------------------------------------------------
    @torch.no_grad()
    def run(
        self,
        observations: Tensor | np.ndarray,
        *,
        seed: int | None = None,
        keep: int | None = None,
        progress: Callable[[int, int], None] | None = None,
        synchronous: bool | None = None,
        windows: bool = False,
    ) -> FilterResult:
        """Filter observations (T, O), NaN where missing.

        Args:
            observations: rows; fully missing rows only propagate.
            seed: of this run's random numbers; by default torch's own go on.
            keep: how many of the last rows to keep for smoothing (all by default). Memory is
                keep × M × N × D numbers.
            progress: called with (rows done, rows in all).
            synchronous: whether the host looks at each row's weights, to leave out resampling where no filter needs
                it and to name a row at once where all weights are zero. By default on a CPU; elsewhere each look
                would be a wait, and a dead filter is found up to a thousand rows later.
            windows: of all rows to keep, have the particles of one window of rows at a time (:mod:`.windows`), where
                there are many.

        Raises ModelError for a model that does not fit the observations (:mod:`invdyn.inference.contract`);
        SMCFailed when all particles of some filter have weight zero.
        """
        observations = check_model(self.model, observations)
        rows, device = len(observations), observations.device
        synchronous = device.type == "cpu" if synchronous is None else synchronous
        shape = self.batch if self.num_filters is not None else (1, *self.batch)
        self._restart(device)
        self._log_weights, self.log_evidence, self.ancestors = (
            value.reshape(*shape[:-1], *value.shape[len(self.batch) - 1 :])
            for value in (self._log_weights, self.log_evidence, self.ancestors)
        )
        self._itself = self.ancestors
        history = History(rows, rows if keep is None else min(keep, rows), shape[0], device)
        self._numbers = torch.arange(rows, device=device).unsqueeze(-1).unbind()
        seen = ~torch.isnan(observations)
        self._seen = seen, seen.all(-1).tolist(), seen.any(-1).tolist()

        def onward(own: "ParticleFilter", particles: Particles, numbers: range, report: Any = progress) -> Particles:
            for t in numbers:
                particles = own._onward(t, observations[t], particles, history, synchronous)
                if report is not None:
                    report(t + 1, rows)
            return particles

        with seeded(seed, device):
            size = window_rows(rows, math.prod(shape), self.model.state_dim) if windows and keep is None else rows
            if size < rows:
                return in_windows(self, history, onward, rows, size)
            onward(self, {}, range(rows))
        return history.result(self.log_evidence)

    def _onward(self, t: int, y: Tensor, particles: Particles, history: History, synchronous: bool) -> Particles:
        """From the particles that go on to row t to those that go on from it."""
        rows, (seen, whole, any_seen) = len(self._numbers), self._seen
        row = self._row(t, y, None if whole[t] else seen[t], particles, any_seen[t], last=t == rows - 1)
        particles, self._log_weights, total, self.ess = row
        self.log_evidence = self.log_evidence + total
        self.row += 1
        history.keep_row(t, particles["x"], self._log_weights, self.ancestors, particles.get("log_twist"))
        self.resampled = self._need(last=t == rows - 1)
        history.note(t, total, self.ess, self.resampled)
        if synchronous:
            self._alive(total[None], t, particles["x"])
        elif self.row % PATIENCE == 0 or self.row == rows:
            first = (t // PATIENCE) * PATIENCE
            self._alive(history.increment[first : t + 1], first)
        return self._resample(particles, synchronous)

    def _row(self, t: int, y: Tensor, seen: Tensor | None, particles: Particles, any_seen: bool, last: bool) -> Row:
        """Row t, by a compiled graph where there is one."""
        if self.compiled and t > 0 and not last:
            # Rows in which nothing was seen share the graph of those with gaps.
            owners = (self.guide, self.model)
            return Row(*self._rows(owners, self._numbers[t], y, seen, particles, self._log_weights))
        return advanced(self.model, self.guide, t, y if any_seen else None, seen, particles, self._log_weights)

    def _need(self, last: bool) -> Tensor:
        """Which filters (…) are to be resampled; the last row's weights are the posterior's, and stay."""
        return (
            torch.zeros_like(self.ess, dtype=torch.bool) if last else self.ess < self.ess_threshold * self.num_particles
        )

    def _resample(self, particles: Particles, synchronous: bool) -> Particles:
        """The particles that go on; sets ``ancestors``, and the weights of those filters that were resampled."""
        if synchronous and not bool(self.resampled.any()):
            self.ancestors = self._itself
            return particles
        found = resampled(self.resampled, particles, self._log_weights, self.resampling)
        particles, self._log_weights, self.ancestors = found
        return particles

    def _alive(self, totals: Tensor, first: int, states: Tensor | None = None) -> None:
        """Raise SMCFailed unless the evidence's increments (R, …) of the rows from ``first`` on are finite.

        Where the ``states`` (…, N, D) there are no numbers the simulation is at fault, and the message says so.
        """
        # The sum is finite if all of them are, and one check replaces many.
        if not math.isfinite(totals.sum().item()):
            rows = ~torch.isfinite(totals).reshape(len(totals), -1)
            row = int(rows.any(-1).int().argmax())
            if states is not None and not bool(torch.isfinite(states).all(-1).any(-1).reshape(-1)[rows[0]].any()):
                raise SMCFailed(ran_away(first + row))
            raise SMCFailed(
                f"all particles of {int(rows[row].sum())} filter(s) have weight zero at "
                f"row {first + row}: the observation is out of the model's reach; use a larger "
                "noise scale, more particles or the controlled guide"
            )

    # -- weights, evidence, resampling of Pyro's way in ------------------------------------------
    def _weigh(self, increment: Tensor) -> None:
        """Add log-weight increments (…, N) and normalise."""
        self._log_weights, total, self.ess = normalised(self._log_weights, increment)
        self._alive(total[None], self.row)
        self.log_evidence = self.log_evidence.to(total.device) + total
        self.row += 1
        self.resampled = self._need(last=False)
