"""Parameters with priors as a method: PMMH and SMC², from a problem to InferenceData.

Each draw has parameters of its own, variables of the posterior by name, and a trajectory of the states given them
(:mod:`invdyn.inference.parameters`).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import arviz as az
import torch

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.parameters.posterior import ParameterPosterior
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem

PREDICTIVE = 7_207_207
"""Place of the random numbers of predictions and of the last resampling (:func:`.seeds.derived`)."""


def learn_parameters(
    problem: StateSpaceProblem,
    *,
    sampler: Callable[..., ParameterPosterior],
    options: SMCOptions | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    **arguments: Any,
) -> az.InferenceData:
    """Sample the parameters that have priors, and the states.

    Args:
        problem: a model with priors (:meth:`.StateSpaceModel.with_priors`), and observations.
        sampler: :func:`.pmmh.pmmh` or :func:`.smc2.smc2`, which have numbers of draws of their own.
        options: not used; here so that all methods have one signature.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        arguments: further ones of the sampler.

    The evidence has the parameters integrated out over their priors. Raises as the sampler does.
    """
    found = sampler(problem.model, problem.observations, seed=seed, progress=progress, **arguments)
    if found.paths is None:
        raise ValueError("expected a trajectory of each draw, got none: leave paths=False out")

    # Parameters (C, R, own shape) meet states (C, R, T, D).
    each = problem.model.replace(**{name: values.unsqueeze(2) for name, values in found.draws.items()})
    with seeded(derived(seed, PREDICTIVE)), torch.no_grad():
        return to_inference_data(
            replace(problem, model=each),
            found.paths,
            method=found.method,
            seed=seed,
            settings=settings or {},
            log_evidence=found.log_evidence,
            log_evidence_sd=found.log_evidence_sd,
            log_evidence_increment=found.log_evidence_increment,
            diagnostics={
                "acceptance": float(found.acceptance.mean()),
                "num_particles": found.num_particles,
                "weight_ess": found.ess,
                "evidence_kind": "estimate",
                **found.statistics,
            },
            parameters=found.draws,
            log_weights=found.log_weights,
        )
