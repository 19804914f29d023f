"""Particle filters: many at once, with the evidence, as a subclass of Pyro's ``SMCFilter``.

Chopin & Papaspiliopoulos (2020), algorithm 10.2 (guided particle filter with adaptive
resampling), extended by a twist (Heng et al. 2020): a guide may state log ψ̃_t(x_t), how well x_t
fits what is yet to come, and the filter then targets p(x_{0:t} | y_{0:t}) ψ̃_t(x_t):

    log w_t = log W_{t−1} + log p(x_t | x_{t−1}) / q(x_t) + log g(y_t | x_t) + log ψ̃_t(x_t) − log ψ̃_{t−1}(x_{t−1})
    log Ẑ  += log Σ_n w_t^n ,   W_t = w_t / Σ w_t ,   resample when 1/Σ W² < threshold · N

ψ̃_T = 1, so the evidence is unbiased, E[Ẑ] = Z, whatever the guide and whenever it resamples.

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

import pyro
import torch
from pyro import poutine
from pyro.infer import SMCFilter
from pyro.infer.smcfilter import SMCFailed
from pyro.poutine.util import prune_subsample_sites
from torch import Tensor

from invdyn.inference.particles import FilterResult, FilterState, History, take
from invdyn.inference.proposal import Particles, Proposal
from invdyn.inference.resampling import ess, resample
from invdyn.models.missing import observed_log_prob


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

    After each row: ``log_evidence`` (M,), ``ess`` (M,) before and ``resampled`` (M,) whether there was resampling,
    ``ancestors`` (M, N) of the particles that go on, and ``row``, the number of rows seen.
    """

    def __init__(
        self,
        model,
        guide,
        num_particles: int,
        max_plate_nesting: int = 0,
        *,
        num_filters: int | None = None,
        ess_threshold: float = 0.5,
        resampling: str = "systematic",
    ):
        if not 0 < ess_threshold <= 1:
            raise ValueError(f"expected an ess_threshold in (0, 1], got {ess_threshold}")
        if num_particles < 1 or (num_filters is not None and num_filters < 1):
            raise ValueError("expected at least one particle and one filter")
        super().__init__(model, guide, num_particles, max_plate_nesting, ess_threshold=ess_threshold)
        self.num_filters = num_filters
        self.resampling = resampling
        self.batch = (num_particles,) if num_filters is None else (num_filters, num_particles)
        self.state = FilterState(self.batch)
        self._restart()

    def _restart(self, device: torch.device | str = "cpu") -> None:
        # float64 for weights and evidence, whatever the states' type.
        uniform = -math.log(self.num_particles)
        self._log_weights = torch.full(self.batch, uniform, dtype=torch.float64, device=device)
        self.log_evidence = self._log_weights.new_zeros(self.batch[:-1])
        self.ancestors = torch.arange(self.num_particles, device=device).expand(self.batch)
        self.row = 0
        self._log_twist: Tensor | None = None

    # -- Pyro's way in -------------------------------------------------------------------------
    def init(self, *args, **kwargs) -> None:
        """Sample row 0 and weight it; arguments go to the model and the guide."""
        self._restart()
        self.state = FilterState(self.batch)
        self._traced("init", args, kwargs)

    def step(self, *args, **kwargs) -> None:
        """Sample the next row and weight it; arguments go to the model and the guide."""
        self._traced("step", args, kwargs)

    def _plates(self):
        """Particle plate, inside a filter plate where there are several filters."""
        dim = -1 - self.max_plate_nesting
        particles = pyro.plate("particles", self.num_particles, dim=dim)
        if self.num_filters is None:
            return [particles]
        return [pyro.plate("filters", self.num_filters, dim=dim - 1), particles]

    def _traced(self, method: str, args, kwargs) -> None:
        plates = self._plates()

        def in_plates(function):
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
        if hasattr(self.guide, "log_twist"):
            twist = self.guide.log_twist(self.state, self.row)
            increment = increment + twist - (0.0 if self._log_twist is None else self._log_twist)
            self._log_twist = twist
        self._weigh(increment)
        index = self._maybe_resample()
        if index is not None:
            self.state._resample(index)
            if self._log_twist is not None:
                self._log_twist = self._log_twist.gather(-1, index)

    def _trace_log_weight(self, model_trace, guide_trace) -> Tensor:
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
        observations: Tensor,
        *,
        keep: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> FilterResult:
        """Filter observations (T, O), NaN where missing.

        Args:
            observations: rows; fully missing rows only propagate.
            keep: how many of the last rows to keep for smoothing (all by default). Memory is
                keep × M × N × D numbers.
            progress: called with (rows done, rows in all).

        Raises SMCFailed when all particles of some filter have weight zero.
        """
        rows = len(observations)
        self._restart(observations.device)
        shape = self.batch if self.num_filters is not None else (1, *self.batch)
        if self.num_filters is None:
            self._log_weights, self.log_evidence = self._log_weights[None], self.log_evidence[None]
            self.ancestors = self.ancestors[None]
        guide: Proposal = self.guide
        history = History(rows, rows if keep is None else min(keep, rows), shape[0], observations.device)
        particles: Particles = {}
        twist = 0.0
        for t in range(rows):
            particles, increment = guide.propose_initial(shape) if t == 0 else guide.propose(t, particles)
            y = observations[t]
            if bool((~torch.isnan(y)).any()):
                increment = increment + observed_log_prob(self.model.emission(particles["x"], t), y)
            if "log_twist" in particles:
                increment = increment + particles["log_twist"] - twist
                twist = particles["log_twist"]
            total = self._weigh(increment)
            history.keep_row(t, particles["x"], self._log_weights, self.ancestors, particles.get("log_twist"))
            index = self._maybe_resample(last=t == rows - 1)
            history.note(t, total, self.ess, self.resampled)
            if index is not None:
                particles = {name: take(value, index) for name, value in particles.items()}
                twist = particles.get("log_twist", 0.0)
            if progress is not None:
                progress(t + 1, rows)
        return history.result(self.log_evidence)

    # -- weights, evidence, resampling: shared -------------------------------------------------
    def _weigh(self, increment: Tensor) -> Tensor:
        """Add log-weight increments (…, N), normalise, and return the evidence's increment (…)."""
        log_weights = self._log_weights + increment.double()
        # A particle whose dynamics overflowed is out of reach of any data; it must not take its filter along.
        log_weights = torch.where(torch.isnan(log_weights), -torch.inf, log_weights)
        total = log_weights.logsumexp(-1)
        if not bool(torch.isfinite(total).all()):
            raise SMCFailed(
                f"all particles of {int((~torch.isfinite(total)).sum())} filter(s) have weight zero at "
                f"row {self.row}: the observation is out of the model's reach; use a larger "
                "noise scale, more particles or the controlled guide"
            )
        self._log_weights = log_weights - total.unsqueeze(-1)
        self.log_evidence = self.log_evidence.to(total.device) + total
        self.row += 1
        return total

    def _maybe_resample(self, last: bool = False) -> Tensor | None:
        """Ancestors (…, N) where any filter must resample, else None; resets those filters' weights."""
        self.ess = ess(self._log_weights)
        need = self.ess < self.ess_threshold * self.num_particles
        if last:
            # The last row's weights are the posterior's: resampling them would only add noise.
            need = torch.zeros_like(need)
        self.resampled = need
        self.state._log_weights = self._log_weights
        identity = torch.arange(self.num_particles, device=need.device).expand(self._log_weights.shape)
        if not bool(need.any()):
            self.ancestors = identity
            return None
        index = torch.where(need.unsqueeze(-1), resample(self._log_weights, self.resampling), identity)
        uniform = -math.log(self.num_particles)
        self._log_weights = torch.where(need.unsqueeze(-1), uniform, self._log_weights)
        self.state._log_weights = self._log_weights
        self.ancestors = index
        return index
