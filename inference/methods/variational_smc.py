"""Variational SMC as a method: learns the guide and the parameters' posterior, then weighs what it has learned.

The bound of :class:`.vsmc.VSMC_ELBO` with the free parameters φ = log(θ/θ_start) drawn from q,

    L = E_q(φ) [ log p̂_φ(y) + log p(φ) − log q(φ) ] ≤ log p(y),       q = N(m, S),  p = N(0, diag sd²)

begins where :func:`.marginal_likelihood.fit` ends: m and S are Laplace's there, with the whole covariance. The
filter's guide is the controlled one of whatever φ is drawn, its smoother made anew, plus a learned correction that
all φ share (:class:`.affine.Corrected`); what the smoother owes to φ is not differentiated, which costs nothing where
the guide is exact. Steps are taken in the coordinates u of φ = m₀ + S₀^½ u, where one learning rate suits all.

A bound prefers a q that is too narrow, and the posterior may be bent. So q is only the proposal of what is reported:
filter m gets its own φ_m, from Student's t of q's location and scale, and the outer sampler weighs

    W_m ∝ p̂_{φ_m}(y) p(φ_m) / q(φ_m),

importance weights of (φ_m, path): pooled draws integrate the parameters out, and their intervals are right even where
q is not. The outer ESS says how good q is.

A direction of φ that the data hardly narrow, such as torque scale against mass, is named in the attributes: see
:func:`unidentified`.

Shapes: P free parameters, M filters.
"""

import dataclasses
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import arviz as az
import pyro
import torch
from pyro.distributions import MultivariateStudentT
from pyro.infer import SVI
from pyro.optim import ClippedAdam
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.progress import Progress, Report
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import backward_simulation, genealogy
from invdyn.inference.filters.filtering import SMCOptions, sufficient_dtype
from invdyn.inference.filters.particle_filter import ParticleFilter
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.fitting.identifiability import unidentified
from invdyn.inference.fitting.marginal_likelihood import Free, LogParameters, fit
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.posterior import combine, to_inference_data
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.smoothing.posterior_linearisation import gaussian_smoother, posterior_linearisation
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.parameter_guide import Following, Uncertain
from invdyn.inference.variational.training import train
from invdyn.inference.variational.vsmc import VSMC_ELBO
from invdyn.models import ArmModel, StateSpaceModel

TAIL = 8.0
"""Degrees of freedom of the proposal: heavier in its tails than q, so that the weights stay bounded."""
WORTH = 0.01
"""Nats that training must gain to be kept."""
PILOTS = 32
"""Filters of a pilot run."""
CHUNK = 500
"""Rows whose graph is held at once, of longer recordings."""


def vsmc(
    problem: Problem,
    *,
    free: Sequence[Free] = (),
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    steps: int = 60,
    learning_rate: float = 0.02,
) -> az.InferenceData:
    """Train the guide, and the posterior of the ``free`` parameters; then run the trained filters.

    Args:
        problem: model and observations; the model's parameters are the centre of the free ones' prior.
        free: parameters to learn; without any, the guide alone is trained, at the model's parameters.
        options: sizes of the filters that are reported; training has 4 of at most 50 particles.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        checkpoint: keeps the training, and goes on from there.
        steps, learning_rate: of Adam; the rate falls tenfold over the steps, and the correction, which has thousands
            of entries, learns at a tenth of it. What has not raised the bound of a pilot run is undone.

    Each chain is one filter; with ``free`` it has parameters of its own, which become variables of the posterior
    ("length", "mass", "com", "inertia" of a body, others by their dotted names). The evidence is an unbiased estimate,
    the parameters integrated out. The attributes of sample_stats hold "vsmc_bound", the mean over filters of what
    the log of that estimates, its standard error "vsmc_bound_sd", "vsmc_gain", what training raised it by in the pilot
    run (0: undone), and "unidentified", a JSON list.

    Raises KeyError for a parameter that the model does not have, SMCFailed when filters lose the observations.
    """
    options = options or SMCOptions()

    def stage(what: str) -> Report | None:
        return None if progress is None else lambda done, total: progress(done, total, what)

    with seeded(seed, options.device), pyro.get_param_store().scope():
        kind = _OverParameters if free else _AtParameters
        learner = kind(problem, free, options, start, stage("fit"))
        gain = learner.train(steps, learning_rate, stage("train"), inside(checkpoint, "vsmc"))
        with torch.no_grad():
            idata, found = learner.posterior(seed, settings or {}, stage("filter"), stage("smooth"))
    each = idata["sample_stats"]["log_evidence"].values
    error = each.std(ddof=1) / math.sqrt(len(each)) if len(each) > 1 else math.nan
    idata["sample_stats"].attrs |= {
        "unidentified": json.dumps(found, ensure_ascii=False),
        "vsmc_bound": float(each.mean()),
        "vsmc_bound_sd": float(error),
        "vsmc_gain": gain,
    }
    return idata


class _Learner(ABC):
    """What the stages of :func:`vsmc` share: the problem, its start, its guide and the model that it is trained for."""

    guide: Corrected
    target: StateSpaceModel

    def __init__(self, problem: Problem, options: SMCOptions, model: ArmModel, start: Tensor | None):
        self.problem, self.options = problem, options
        self.observations = problem.observations.double()
        self.smoother = gaussian_smoother(model, self.observations, start)
        self.dtype = options.dtype or sufficient_dtype(self.smoother)
        self.model = model.to(dtype=self.dtype, device=options.device)
        self.rows = self.observations.to(dtype=self.dtype, device=options.device)

    @abstractmethod
    def posterior(
        self, seed: int, settings: dict, report: Report | None, smoothing: Report | None
    ) -> tuple[az.InferenceData, list[dict]]:
        """What the trained filters find; and what of the parameters is not identified."""

    @abstractmethod
    def bound(self, count: int) -> Tensor:
        """Log of the weights' numerator over denominator, (M,), of ``count`` filters."""

    def train(self, steps: int, learning_rate: float, report: Report | None, checkpoint: Checkpoint | None) -> float:
        """Ascend the bound; the parameters stay in Pyro's store. Returns the gain; 0 where it was undone."""
        if steps == 0:
            return 0.0
        slow = {"lr": learning_rate / 10, "lrd": 0.1 ** (1 / steps), "clip_norm": 100.0}
        fast = {**slow, "lr": learning_rate}
        own = (f"{self.guide.name}.loc", f"{self.guide.name}.root")
        chunk = CHUNK if len(self.rows) > 2 * CHUNK else None
        particles = min(self.options.num_particles, 50)
        loss = VSMC_ELBO(particles, num_filters=4, ess_threshold=self.options.ess_threshold, chunk=chunk)
        svi = SVI(self.target, self.guide, ClippedAdam(lambda name: fast if name in own else slow), loss=loss)
        seed = int(torch.randint(2**31, ()))
        before = self._pilot(seed)
        train(svi, steps, self.rows, checkpoint=checkpoint, report=report)
        gain = self._pilot(seed) - before
        if not gain > WORTH:
            pyro.clear_param_store()  # all of them begin at the start
            return 0.0
        return gain

    @torch.no_grad()
    def _pilot(self, seed: int) -> float:
        """The bound, by filters whose random numbers are the same before and after training."""
        with seeded(seed, self.options.device):
            return self.bound(PILOTS).mean().item()

    def _filters(self, model: StateSpaceModel, guide: Corrected, count: int, report: Report | None) -> FilterResult:
        o = self.options
        filters = ParticleFilter(
            model,
            guide,
            o.num_particles,
            num_filters=count,
            ess_threshold=o.ess_threshold,
            resampling=o.resampling,
        )
        return filters.run(self.rows, progress=report)

    def settings(self, given: dict) -> dict:
        """What is recorded."""
        names = ("num_filters", "num_particles", "resampling")
        return {**given, **{name: getattr(self.options, name) for name in names}}


class _AtParameters(_Learner):
    """Parameters as they are: only the guide is learned."""

    def __init__(
        self, problem: Problem, free: Sequence[Free], options: SMCOptions, start: Tensor | None, report: Report | None
    ):
        super().__init__(problem, options, problem.model.to(dtype=torch.float64), start)
        self.guide, self.target = Corrected(self.model, self.rows, self.smoother), self.model

    def bound(self, count: int) -> Tensor:
        """The filters' evidence."""
        return self._trained(count, None).log_evidence

    def _trained(self, count: int, report: Report | None) -> FilterResult:
        return self._filters(self.model, self.guide.sampled(self.model), count, report)

    def posterior(
        self, seed: int, settings: dict, report: Report | None, smoothing: Report | None
    ) -> tuple[az.InferenceData, list[dict]]:
        """Filters with the trained guide, smoothed."""
        result = self._trained(self.options.num_filters, report)
        paths = backward_simulation(
            self.model,
            result,
            self.rows,
            self.options.num_draws,
            smoother=self.smoother,
            progress=smoothing,
        )
        own = self.settings(settings)
        return to_inference_data(self.problem, paths, result, method="vsmc", seed=seed, settings=own), []


class _OverParameters(_Learner):
    """Parameters learned: each filter has its own."""

    guide: Following
    target: Uncertain

    def __init__(
        self, problem: Problem, free: Sequence[Free], options: SMCOptions, start: Tensor | None, report: Report | None
    ):
        model = problem.model.to(dtype=torch.float64)
        found = fit(model, problem.observations.double(), free, start=start, progress=report)
        self.log_parameters = LogParameters(model, free)
        root = torch.linalg.cholesky(torch.as_tensor(found.covariance))
        centre = torch.as_tensor(found.phi)
        super().__init__(problem, options, found.model, found.path)
        self.guide = Following(self.model, self.rows, self.smoother, len(centre))
        base = LogParameters(problem.model.to(dtype=self.dtype, device=options.device), free)
        self.target = Uncertain(base, centre, root)

    def bound(self, count: int) -> Tensor:
        """The filters' evidence, each at parameters of its own, times p(φ)/q(φ)."""
        return self._drawn(count, None)[0]

    def _drawn(self, count: int, report: Report | None) -> tuple[Tensor, FilterResult, Tensor]:
        """Log of the weights' numerator over denominator (M,), the filters, and their φ (M, P)."""
        loc, root = self.guide.location_and_root()
        proposal = MultivariateStudentT(TAIL, loc, root)
        u = proposal.sample((count,))
        phi = self.target.phi(u)
        result = self._each(phi, report)
        ratio = self.target.prior.log_prob(u) - proposal.log_prob(u)
        return result.log_evidence + ratio.to(result.log_evidence), result, phi

    def posterior(
        self, seed: int, settings: dict, report: Report | None, smoothing: Report | None
    ) -> tuple[az.InferenceData, list[dict]]:
        """Filters, each with parameters of its own; and what of them is not identified."""
        evidence, result, phi = self._drawn(self.options.num_filters, report)
        paths = genealogy(result, self.options.num_draws)
        found = unidentified(self.log_parameters, phi, evidence)
        settings = self.settings({**settings, "unidentified": found})
        parts = [self._part(m, phi[m], paths, result, evidence, seed, settings) for m in range(len(phi))]
        idata = combine(parts, seed)
        for f in self.log_parameters.free:
            if not f.name.startswith("body."):
                self._add(idata, f.name, self.log_parameters.at(phi).parameters[f.name].squeeze(1))
        middle = self.target.phi(self.guide.location_and_root()[0])
        mean = dataclasses.replace(self.problem, model=self.log_parameters.at(middle))
        constant = to_inference_data(mean, paths[:1], method="vsmc", seed=seed, settings={})["constant_data"]
        idata["constant_data"].update(constant)
        return idata, found

    def _each(self, phi: Tensor, report: Report | None) -> FilterResult:
        """Filter m at φ_m (M, P), its smoother and guide its own."""
        many = self.log_parameters.at(phi)
        start = self.smoother.path.expand(len(phi), -1, -1)
        smoothers = posterior_linearisation(
            many, self.observations, gauss_newton(many, self.observations, start=start), 1
        )
        found = torch.isfinite(smoothers.log_evidence) & torch.isfinite(smoothers.path).all(-1).all(-1)
        guides = []
        for m, one in enumerate(phi):
            model = self.target.log_parameters.at(one)
            smoother = _of_set(smoothers, m) if found[m] else self.smoother
            guides.append(Corrected(model, self.rows, smoother, name=self.guide.name).sampled(model))
        model = self.target.log_parameters.at(phi)
        return self._filters(model, Corrected.stacked(guides, model), len(phi), report)

    def _part(
        self, m: int, phi: Tensor, paths: Tensor, result: FilterResult, evidence: Tensor, seed: int, settings: dict
    ) -> az.InferenceData:
        """InferenceData of filter m."""
        problem = dataclasses.replace(self.problem, model=self.log_parameters.at(phi))
        own = dataclasses.replace(
            result,
            log_evidence=evidence[m : m + 1],
            log_evidence_increment=result.log_evidence_increment[:, m : m + 1],
            ess=result.ess[:, m : m + 1],
            resampled=result.resampled[:, m : m + 1],
        )
        return to_inference_data(problem, paths[m : m + 1], own, method="vsmc", seed=seed, settings=settings)

    def _add(self, idata: az.InferenceData, name: str, values: Tensor) -> None:
        """A variable [chain, draw, …] of the posterior; entries are joints where there are as many."""
        posterior = idata["posterior"]
        own = [
            "joint" if size == posterior.sizes["joint"] else f"{name}_dim_{k}"
            for k, size in enumerate(values.shape[1:])
        ]
        values = values.unsqueeze(1).expand(-1, posterior.sizes["draw"], *values.shape[1:])
        posterior[name] = (["chain", "draw", *own], values.numpy())


def _of_set(smoothers: GaussianSmoother, m: int) -> GaussianSmoother:
    """Set m of a batch of smoothers."""

    def pick(value: Any) -> Any:
        if dataclasses.is_dataclass(value):
            kind: Any = type(value)
            return kind(**{f.name: pick(getattr(value, f.name)) for f in dataclasses.fields(value)})
        return None if value is None else value[m]

    return pick(smoothers)
