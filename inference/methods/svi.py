"""Stochastic variational inference as a method: a guide of whole paths (:mod:`.path_guides`), and its bound."""

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.best_guide import second_opinion
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.second_opinion import bound_doubt
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.inference.variational.path_bound import bound, maximise, path_model
from invdyn.inference.variational.path_guides import Markov, MeanField

GUIDES = {"svi": MeanField, "svi-markov": Markov}


def svi(
    problem: StateSpaceProblem,
    *,
    guide: str = "svi",
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    max_steps: int = 3000,
) -> az.InferenceData:
    """Variational posterior and its bound on the evidence.

    Args are those of :func:`.smc.smc`, and:
        guide: a key of ``GUIDES``: "svi" (mean field) or "svi-markov".
        options: num_filters × num_draws are the chains × draws of the result; all draws are independent.
        max_steps: gradient steps at most.
    """
    options = options or SMCOptions()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    smoother = gaussian_smoother(model, observations, start)
    with seeded(seed):
        fitted = GUIDES[guide](smoother)
        steps, converged = maximise(fitted, path_model(model, observations), max_steps=max_steps, progress=progress)
        value, error = bound(fitted, model, observations)
        with torch.no_grad():
            paths = fitted.distribution().sample((options.num_filters, options.num_draws))
        pilot = second_opinion(model, observations, options, seed, start)
        doubt = bound_doubt(value, paths[0, 0].numel(), pilot)
        return to_inference_data(
            problem,
            paths,
            method=guide,
            seed=seed,
            settings=settings or {},
            log_evidence=value,
            log_evidence_sd=error,
            bound=True,
            diagnostics={
                "steps": steps,
                "converged": int(converged),
                "usable": int(not doubt),
                "doubt": doubt,
            },
        )
