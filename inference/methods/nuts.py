"""NUTS as a method, on short series: the reference that others are held against (:mod:`invdyn.inference.mcmc.nuts`)."""

import math

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.mcmc.mixing import mixing
from invdyn.inference.mcmc.nuts import sample_paths
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.posterior_linearisation import gaussian_smoother
from invdyn.recordings import InputError

LONGEST = 100
"""Rows that NUTS can be waited for."""
FEWEST_DRAWS = 4
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

    Args:
        problem: model and observations, at most ``LONGEST`` rows.
        options: num_filters × num_draws draws in all, shared out among the chains.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        chains, warmup: chains, begun apart from one another, and steps of each that are thrown away.

    The attributes of sample_stats hold the largest R-hat and the smallest effective sample sizes of any number
    that the problem monitors,
    and the number of divergent steps. Raises InputError for a longer series, or fewer draws of
    a chain than ``FEWEST_DRAWS``.
    """
    options = options or SMCOptions()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    if len(observations) > LONGEST:
        raise InputError(
            f"NUTS is a reference for short series: expected at most {LONGEST} frames, got {len(observations)}; "
            "select a stretch, or use smc"
        )
    draws = math.ceil(options.num_filters * options.num_draws / chains)
    if draws < FEWEST_DRAWS:
        raise InputError(
            f"nuts: expected {FEWEST_DRAWS} draws of each of {chains} chains, for R-hat, got {draws}: "
            f"let --filters × --draws be {FEWEST_DRAWS * chains} or more"
        )
    whitening = GaussianChain.of(gaussian_smoother(model, observations, start))
    with seeded(seed):
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
