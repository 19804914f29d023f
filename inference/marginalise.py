"""Uncertain bodies and parameters, marginalised: the outer sampler runs over parameter sets too.

Each of S sets θ_s is drawn from the body's priors and gets M/S filters of its own. The outer weights

    W_m ∝ Ẑ_m(θ_{s(m)})

are then importance weights of the pair (θ_s, trajectory), so pooled draws integrate the body out, and
the mean of the Ẑ_m is the evidence with θ integrated out (unbiased). Where the torque's process and parameters are
uncertain, too, each set has some of its own (:mod:`.fitting.parameter_draws`), and Ẑ_m the set's offset.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any

import arviz as az
import torch
from pyro import poutine

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import Tensors, distribute
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.fitting.parameter_draws import ParameterSet
from invdyn.inference.posterior.files import packed, unpacked
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.lengths import as_fitted
from invdyn.inference.posterior.posterior import combine

Method = Callable[..., az.InferenceData]
NUM_SETS = 16


def body_draws(sets: Sequence[Problem], seed: int) -> list[Problem]:
    """The problems with bodies that are drawn from their priors, where they have any."""
    problems = []
    with seeded(seed), poutine.block():
        for problem in sets:
            if not problem.model.body.has_priors:
                problems.append(problem)
                continue
            drawn = as_fitted(problem).sample(dtype=problem.model.dtype)._asdict()
            model = problem.model.replace(**{f"body.{name}": value for name, value in drawn.items()})
            problems.append(dataclasses.replace(problem, model=model))
    return problems


def over_bodies(
    method: Method,
    problem: Problem,
    *,
    options: SMCOptions,
    num_sets: int = NUM_SETS,
    sets: Sequence[ParameterSet] = (),
    seed: int = 0,
    start: torch.Tensor | None = None,
    settings: dict | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
) -> az.InferenceData:
    """Run ``method`` on ``num_sets`` bodies (at most one a filter) and combine the results.

    Arguments as those of :func:`.smc.smc`; a body is a task, and with an ``executor`` the method must pickle. The
    result's posterior also holds each draw's length, mass, com and inertia, where they differ. With ``sets`` these are
    the models, one body is drawn for each, and ``start`` and ``num_sets`` do not count.
    """
    num_sets = len(sets) or min(num_sets, options.num_filters)
    sizes = [len(part) for part in torch.arange(options.num_filters).tensor_split(num_sets)]
    few = [dataclasses.replace(options, num_filters=size, refits=min(options.refits, 1)) for size in sizes]
    problems = [dataclasses.replace(problem, model=each.model) for each in sets] or [problem] * num_sets
    bodies = body_draws(problems, seed)
    starts: list[torch.Tensor | None] = [each.path for each in sets] if sets else [start] * num_sets
    parts: list[Any] = distribute(
        run_body if checkpoint is None else run_body_to_keep,
        [(method, bodies[s], few[s], derived(seed, s), starts[s], settings) for s in range(num_sets)],
        [f"parameter set {s + 1} of {num_sets}" for s in range(num_sets)],
        executor=executor,
        checkpoint=checkpoint,
        progress=stage(progress, "bodies"),
    )
    found = parts if checkpoint is None else [unpacked(part) for part in parts]
    for part, each in zip(found, sets, strict=bool(sets)):
        part["sample_stats"]["log_evidence"] = part["sample_stats"]["log_evidence"] + each.offset
    return combine(found, seed=seed)


def run_body(
    method: Method,
    problem: Problem,
    options: SMCOptions,
    seed: int,
    start: torch.Tensor | None,
    settings: dict | None,
    progress: Callable[[int, int], None] | None = None,
) -> Any:
    """Run ``method`` on one body: what one worker does. Returns InferenceData, which pickles."""
    idata = method(problem, options=options, start=start, seed=seed, settings=settings)
    if progress is not None:
        progress(1, 1)
    return idata


def run_body_to_keep(*arguments: Any, progress: Callable[[int, int], None] | None = None) -> Tensors:
    """The same as tensors, for a checkpoint: a netCDF file in bytes takes longer to write than to compute."""
    idata = run_body(*arguments)
    if progress is not None:
        progress(1, 1)
    return packed(idata)
