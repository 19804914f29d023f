"""SMC as a method: filters, the outer sampler and smoothing, from a problem to InferenceData.

Biderman et al. (2020) with three changes: the guide looks ahead (:mod:`.controlled`) where pilot runs bear it out
(:mod:`.best_guide`), what is reported is the smoothed posterior (:mod:`.backward_simulation`), not the filter, and
whether its evidence may be used (:mod:`.second_opinion`): attributes "usable", "doubt" and "guide" of sample_stats.
"""

from concurrent.futures import Executor
from dataclasses import replace

import arviz as az
import numpy as np
import torch

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import distribute, inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import Guide, best_guide
from invdyn.inference.filters.filtering import PER_FILTER, SMCOptions, run_task
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem

PILOTS, FILTERS, PREDICTIVE = range(3)
"""Places of the random numbers of one run (:func:`.seeds.derived`)."""


def smc(
    problem: StateSpaceProblem,
    *,
    guide: str = "controlled",
    options: SMCOptions | None = None,
    start: torch.Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
) -> az.InferenceData:
    """Nested SMC with smoothing.

    Args:
        problem: model and observations.
        guide: "controlled", which :func:`.best_guide` may overrule, or "bootstrap".
        options: sizes.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        executor: whose workers run the filters, ``options.filters_per_task`` at a time; the guide is fitted here.
        checkpoint: keeps the guide and the filters that are done, and continues from there.

    Raises LostWork when a task's workers died each time, SMCFailed when all particles of a filter have weight zero.
    """
    options = options or SMCOptions()
    options.check()
    model, observations = problem.model, problem.observations
    method = guide if guide == "bootstrap" else "smc"
    checkpoint = inside(checkpoint, method)
    chosen = Guide("bootstrap", None, options.num_particles)
    if guide == "controlled":
        chosen = fitted_guide(problem, options, start, seed, inside(checkpoint, "guide"))
    options, smoother = replace(options, num_particles=chosen.num_particles), chosen.smoother
    sizes = options.tasks()
    ends = np.cumsum(sizes)
    parts = distribute(
        run_task,
        [
            (model, observations, replace(options, num_filters=size), chosen.name, smoother, derived(seed, FILTERS, k))
            for k, size in enumerate(sizes)
        ],
        [f"filters {end - size} to {end - 1}" for size, end in zip(sizes, ends, strict=True)],
        executor=executor,
        checkpoint=checkpoint,
        steps=2 * len(observations),
        progress=stage(progress, "filter and smooth"),
    )
    joined = {name: torch.cat([part[name] for part in parts], dim) for name, dim in PER_FILTER.items()}
    evidence = chosen.judged(joined["log_evidence"])
    dropped = torch.empty(0)  # the particles stay where they were made
    result = FilterResult(**joined, states=dropped, log_weights=dropped, log_twist=None, ancestors=dropped)
    with seeded(derived(seed, PREDICTIVE)):
        return to_inference_data(
            problem,
            torch.cat([part["paths"] for part in parts]),
            result,
            method=method,
            seed=seed,
            diagnostics={
                "usable": int(evidence.usable),
                "doubt": evidence.reason,
                "contradicted": evidence.contradicted,
                "guide": evidence.guide,
                "guide_reason": chosen.reason,
            },
            settings={
                **(settings or {}),
                "num_filters": options.num_filters,
                "num_particles": options.num_particles,
                "filters_per_task": sizes[0],
                "resampling": options.resampling,
            },
        )


def fitted_guide(
    problem: StateSpaceProblem,
    options: SMCOptions,
    start: torch.Tensor | None,
    seed: int,
    checkpoint: Checkpoint | None,
) -> Guide:
    """:func:`.best_guide`, or the one that was kept."""
    if checkpoint is not None and (kept := checkpoint.load()) is not None:
        return Guide.kept(*kept)
    with seeded(derived(seed, PILOTS), options.device):
        guide = best_guide(problem.model, problem.observations, options, start=start)
    if checkpoint is not None:
        tensors, state = guide.to_keep()
        checkpoint.save(tensors, **state)
    return guide
