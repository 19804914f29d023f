"""The Gaussian smoother alone, as a method: fast, and exact for linear-Gaussian models.

Draws are exact ones of the linearised model's posterior (:class:`.gaussian_chain.GaussianChain`); the evidence is
that model's.
"""

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import has_own_start, second_opinion
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.second_opinion import approximation_doubt
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.posterior_linearisation import gaussian_smoother

PILOT = 1
"""Place of the random numbers of the pilot (:func:`.seeds.derived`)."""


def laplace(
    problem: StateSpaceProblem,
    *,
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Posterior and evidence of the linearised model.

    Args:
        problem: model and observations.
        options: num_filters × num_draws are the chains × draws of the result; all draws are independent.
        start: path (T, D) to linearise at first.
        seed: of the draws.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).

    Where a model has no start of its own (:meth:`.StateSpaceModel.initial_paths`) the linearisation may end in a wrong
    mode: a bootstrap pilot is a second opinion, and the attributes "usable" and "doubt" of sample_stats say whether
    the evidence stands.
    """
    options = options or SMCOptions()
    smoother = gaussian_smoother(problem.model, problem.observations, start)
    opinion: dict[str, int | str] = {}
    if start is None and not has_own_start(problem.model):
        pilot = second_opinion(problem.model, problem.observations, options, derived(seed, PILOT))
        doubt = approximation_doubt(smoother.log_evidence.item(), pilot)
        opinion = {"usable": int(not doubt), "doubt": doubt}
    with seeded(seed), torch.no_grad():
        paths = GaussianChain.of(smoother).sample((options.num_filters, options.num_draws))
        if progress is not None:
            progress(1, 1, "smooth")
        return to_inference_data(
            problem,
            paths,
            method="laplace",
            seed=seed,
            settings=settings or {},
            log_evidence=smoother.log_evidence.item(),
            diagnostics={"converged": int(smoother.converged), **opinion},
        )
