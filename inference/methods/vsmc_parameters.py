"""Variational SMC over parameters: each filter has its own, drawn from what was learned, and is weighed by them.

What is learned of the parameters, and how it is weighed, stands in :mod:`.variational_smc`.

Shapes: P free parameters, M filters.
"""

import dataclasses
from collections.abc import Sequence

import arviz as az
import torch
from pyro.distributions import MultivariateStudentT
from torch import Tensor

from invdyn.inference.execution.progress import Report
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.second_opinion import approximation_doubt, scatter_doubt
from invdyn.inference.filters.second_opinion import evidence as outer_evidence
from invdyn.inference.fitting.identifiability import unidentified
from invdyn.inference.fitting.log_parameters import Free, LogParameters
from invdyn.inference.fitting.marginal_likelihood import fit
from invdyn.inference.methods.vsmc_learner import Learner
from invdyn.inference.posterior.posterior import combine, to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.parameter_guide import Following, Uncertain


class OverParameters(Learner):
    """Parameters learned: each filter has its own."""

    guide: Following
    target: Uncertain

    def __init__(
        self,
        problem: StateSpaceProblem,
        free: Sequence[Free],
        options: SMCOptions,
        start: Tensor | None,
        report: Report | None,
    ):
        model = problem.model.to(dtype=torch.float64)
        found = fit(model, problem.observations.double(), free, start=start, progress=report)
        self.log_parameters = LogParameters(model, free)
        root = torch.linalg.cholesky(torch.as_tensor(found.covariance))
        centre = torch.as_tensor(found.phi)
        super().__init__(problem, options, found.model, found.path)
        self.start = start  # for the pilot: what the fit itself found may be a wrong mode
        self.guide = Following(self.model, self.rows, self.smoother, len(centre))
        base = LogParameters(problem.model.to(dtype=self.dtype, device=options.device), free)
        self.target = Uncertain(base, centre, root)

    def bound(self, count: int) -> Tensor:
        """The filters' evidence, each at parameters of its own, times p(φ)/q(φ)."""
        return self._drawn(count, None)[0]

    def _drawn(self, count: int, report: Report | None) -> tuple[Tensor, FilterResult, Tensor]:
        """Log of the weights' numerator over denominator (M,), the filters, and their φ (M, P)."""
        loc, root = self.guide.location_and_root()
        # Of eight degrees of freedom: heavier in its tails than q, so that the weights stay bounded.
        proposal = MultivariateStudentT(8.0, loc, root)
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
        middle = self.target.phi(self.guide.location_and_root()[0])
        mean = dataclasses.replace(self.problem, model=self.log_parameters.at(middle))
        constant = to_inference_data(mean, paths[:1], method="vsmc", seed=seed, settings={})["constant_data"]
        idata["constant_data"].update(constant)
        # The pilot is of the fitted parameters, as the smoother is; the filters have others each.
        doubt = scatter_doubt(outer_evidence(evidence, "vsmc"))
        doubt = doubt or approximation_doubt(self.smoother.log_evidence.item(), self.pilot(seed))
        idata["sample_stats"].attrs |= {"usable": int(not doubt), "doubt": doubt}
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
            smoother = smoothers.of_set(m) if found[m] else self.smoother
            guides.append(Corrected(model, self.rows, smoother, name=self.guide.name).sampled(model))
        model = self.target.log_parameters.at(phi)
        return self._filters(model, Corrected.stacked(guides, model), len(phi), report)

    def _part(
        self, m: int, phi: Tensor, paths: Tensor, result: FilterResult, evidence: Tensor, seed: int, settings: dict
    ) -> az.InferenceData:
        """InferenceData of filter m."""
        problem = dataclasses.replace(self.problem, model=self.log_parameters.at(phi))
        own = result.of_filters(slice(m, m + 1), evidence)
        # Those of a body are constants of each part, and become variables where parts are combined.
        names = [f.name for f in self.log_parameters.free if not f.name.startswith("body.")]
        parameters = problem.model.parameters
        values = {name: parameters[name].expand(1, paths.shape[1], *parameters[name].shape) for name in names}
        return to_inference_data(
            problem, paths[m : m + 1], own, method="vsmc", seed=seed, settings=settings, parameters=values
        )
