"""Uncertain bodies, marginalised: the outer sampler runs over parameter sets too.

Each of S sets θ_s is drawn from the body's priors and gets M/S filters of its own. The outer weights

    W_m ∝ Ẑ_m(θ_{s(m)})

are then importance weights of the pair (θ_s, trajectory), so pooled draws integrate the body out, and
the mean of the Ẑ_m is the evidence with θ integrated out (unbiased).
"""

import dataclasses
from collections.abc import Callable

import arviz as az
import pyro
import torch
from pyro import poutine

from invdyn.inference.initialise import Problem
from invdyn.inference.posterior import combine
from invdyn.inference.smc import Progress, SMCOptions


def body_draws(problem: Problem, count: int, seed: int) -> list[Problem]:
    """``count`` problems whose bodies are drawn from their priors."""
    problems = []
    with torch.random.fork_rng(devices=[]), poutine.block():
        pyro.set_rng_seed(seed)
        for _ in range(count):
            drawn = problem.model.body.sample(dtype=problem.model.dtype)._asdict()
            model = problem.model.replace(**{f"body.{name}": value for name, value in drawn.items()})
            problems.append(dataclasses.replace(problem, model=model))
    return problems


def over_bodies(
    method: Callable[..., az.InferenceData],
    problem: Problem,
    *,
    options: SMCOptions,
    num_sets: int = 16,
    seed: int = 0,
    start: torch.Tensor | None = None,
    settings: dict | None = None,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Run ``method`` on ``num_sets`` bodies (at most one a filter) and combine the results.

    Arguments as those of :func:`.smc.smc`. The result's posterior also holds each draw's length, mass,
    com and inertia.
    """
    num_sets = min(num_sets, options.num_filters)
    sizes = [len(part) for part in torch.arange(options.num_filters).tensor_split(num_sets)]
    parts = []
    for s, (size, one) in enumerate(zip(sizes, body_draws(problem, num_sets, seed), strict=True)):
        few = dataclasses.replace(options, num_filters=size, refits=min(options.refits, 1))
        # Seeds of different sets are far apart, and the same whatever else is run.
        own = int(torch.tensor(seed * 1_000_003 + 7919 * (s + 1)) % (2**31))
        parts.append(method(one, options=few, start=start, seed=own, settings=settings))
        if progress is not None:
            progress(s + 1, num_sets, "bodies")
    return combine(parts, seed=seed)
