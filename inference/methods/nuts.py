"""NUTS as a method, on short series: the reference for others (:mod:`invdyn.inference.mcmc.nuts`)."""

import math

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.moment_matching import MomentMatched, moment_matched
from invdyn.inference.mcmc.mixing import mixing
from invdyn.inference.mcmc.nuts import sample_paths
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import StateSpaceModel
from invdyn.recordings import InputError
from invdyn.recordings.errors import first_line

MAX_ROWS = 100
"""Rows that NUTS can be waited for."""
MIN_DRAWS = 4
"""Of a chain: R-hat compares the halves of each, which need a variance."""


def nuts(
    problem: StateSpaceProblem,
    *,
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    chains: int = 4,
    warmup: int = 150,
) -> az.InferenceData:
    """Sample the posterior by NUTS; no evidence (NaN).

    Args are those of :func:`.smc.smc`, and:

    - problem: model and observations, at most ``MAX_ROWS`` rows. The states are real numbers without bounds, and
      log p(x, y) has a gradient; dynamics need not be Gaussian, and y_t may depend on x_{t−1}.
    - options: num_filters × num_draws draws in all, shared out among the chains.
    - chains, warmup: chains, started apart from one another, and steps of each that are thrown away.

    The attributes of sample_stats hold the largest R-hat and the smallest effective sample sizes of any number
    that the problem monitors, and the number of divergent steps. Raises InputError for a longer series, or fewer draws
    of a chain than ``MIN_DRAWS``; ModelError, an InputError, for a model that NUTS cannot sample.
    """
    options = options or SMCOptions()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    if len(observations) > MAX_ROWS:
        raise InputError(
            f"NUTS is a reference for short series: expected at most {MAX_ROWS} frames, got {len(observations)}; "
            "select a stretch, or use smc"
        )
    draws = math.ceil(options.num_filters * options.num_draws / chains)
    if draws < MIN_DRAWS:
        raise InputError(
            f"nuts: expected {MIN_DRAWS} draws of each of {chains} chains, for R-hat, got {draws}: "
            f"let --filters × --set draws be {MIN_DRAWS * chains} or more"
        )
    with seeded(seed):
        whitening = whitening_chain(model, observations, start)
        paths, statistics = sample_paths(
            model,
            observations,
            whitening,
            chains=chains,
            draws=draws,
            warmup=warmup,
            seed=seed,
            progress=stage(progress, "nuts"),
        )
        torch.manual_seed(seed)
        return to_inference_data(
            problem,
            paths,
            method="nuts",
            seed=seed,
            settings={**(settings or {}), "chains": chains, "warmup": warmup},
            diagnostics={**mixing(problem.monitored(paths)), "divergences": int(statistics["diverging"].sum())},
            statistics=statistics,
        )


def whitening_chain(model: StateSpaceModel, observations: Tensor, start: Tensor | None = None) -> GaussianChain:
    """The Gaussian chain near the posterior through whose innovations NUTS samples.

    It is that of the model's approximation (:mod:`.moment_matching`), whose rows depend on x_t alone. Raises ModelError
    for a model with states that are integers or have bounds, without a transition density, or without a gradient.
    """
    observations = check_model(model, observations, needs=("continuous_state", "transition_density"))
    try:
        like = MomentMatched(model) if model.emission_sees_previous else moment_matched(model)
        chain = GaussianChain.of(gaussian_smoother(like, observations, start))
    except TypeError as error:
        raise ModelError(f"{type(model).__name__}: {first_line(error)}, NUTS does not") from error
    if not _has_gradient(model, observations, chain):
        expected = "a log-density with a finite gradient with respect to the states"
        raise ModelError(f"{type(model).__name__}: expected {expected}, got none: keep to torch, or use smc")
    return chain


def _has_gradient(model: StateSpaceModel, observations: Tensor, chain: GaussianChain) -> bool:
    """Whether the gradient of log p(x, y) is its slope, by differences along one direction at the chain's mean.

    Numbers that pass through numpy, or are detached, leave the gradient without their share.
    """
    direction = torch.randn(chain.loc.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))

    def value(step: Tensor) -> Tensor:
        return model.log_joint(chain.path(step * direction), observations)

    step, at = 1e-4, torch.zeros((), dtype=torch.float64, requires_grad=True)
    try:
        (found,) = torch.autograd.grad(value(at), at)
    except RuntimeError:
        return False
    with torch.no_grad():
        slope = (value(at + step) - value(at - step)) / (2 * step)
    return bool(torch.isclose(found, slope, rtol=1e-2, atol=1e-2))
