"""Uncertain bodies, marginalised: the outer sampler runs over parameter sets too.

Each of S sets θ_s is drawn from the body's priors and gets M/S filters of its own. The outer weights

    W_m ∝ Ẑ_m(θ_{s(m)})

are then importance weights of the pair (θ_s, trajectory), so pooled draws integrate the body out, and
the mean of the Ẑ_m is the evidence with θ integrated out (unbiased).
"""

import dataclasses
from collections.abc import Callable
from concurrent.futures import Executor

import arviz as az
import torch
from pyro import poutine

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import Tensors, distribute
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.posterior.files import packed, unpacked
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.lengths import as_fitted
from invdyn.inference.posterior.posterior import combine

Method = Callable[..., az.InferenceData]


def body_draws(problem: Problem, count: int, seed: int) -> list[Problem]:
    """``count`` problems whose bodies are drawn from their priors."""
    problems = []
    with seeded(seed), poutine.block():
        for _ in range(count):
            drawn = as_fitted(problem).sample(dtype=problem.model.dtype)._asdict()
            model = problem.model.replace(**{f"body.{name}": value for name, value in drawn.items()})
            problems.append(dataclasses.replace(problem, model=model))
    return problems


def over_bodies(
    method: Method,
    problem: Problem,
    *,
    options: SMCOptions,
    num_sets: int = 16,
    seed: int = 0,
    start: torch.Tensor | None = None,
    settings: dict | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
) -> az.InferenceData:
    """Run ``method`` on ``num_sets`` bodies (at most one a filter) and combine the results.

    Arguments as those of :func:`.smc.smc`; a body is a task, and with an ``executor`` the method must pickle. The
    result's posterior also holds each draw's length, mass, com and inertia.
    """
    num_sets = min(num_sets, options.num_filters)
    sizes = [len(part) for part in torch.arange(options.num_filters).tensor_split(num_sets)]
    few = [dataclasses.replace(options, num_filters=size, refits=min(options.refits, 1)) for size in sizes]
    bodies = body_draws(problem, num_sets, seed)
    parts = distribute(
        run_body,
        [(method, bodies[s], few[s], derived(seed, s), start, settings) for s in range(num_sets)],
        [f"body draw {s + 1} of {num_sets}" for s in range(num_sets)],
        executor=executor,
        checkpoint=checkpoint,
        progress=stage(progress, "bodies"),
    )
    return combine([unpacked(part) for part in parts], seed=seed)


def run_body(
    method: Method,
    problem: Problem,
    options: SMCOptions,
    seed: int,
    start: torch.Tensor | None,
    settings: dict | None,
    progress: Callable[[int, int], None] | None = None,
) -> Tensors:
    """Run ``method`` on one body: what one worker does."""
    idata = method(problem, options=options, start=start, seed=seed, settings=settings)
    if progress is not None:
        progress(1, 1)
    return packed(idata)
