"""SMC as a method: filters, the outer sampler and smoothing, from a problem to InferenceData.

Biderman et al. (2020) with three changes: the guide looks ahead (:mod:`.controlled`) where pilot runs bear it out
(:mod:`.best_guide`), what is reported is the smoothed posterior (:mod:`.backward_simulation`), not the filter, and
whether its evidence may be used (:mod:`.second_opinion`): attributes "usable", "doubt" and "guide" of sample_stats.

Filters of many states may differ by nats for any number of particles that a run may have: the few that carry the weight
make no bands. On demand the Gaussian of the linearised model is the answer there, if its passes settled and its log
evidence is not below theirs by more than half a nat a number, as it is in another mode (:func:`.bound_doubt`).
"""

from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import arviz as az
import numpy as np
import torch

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import distribute, inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.records import keep, kept
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import RECORDS, Guide, best_guide
from invdyn.inference.filters.filtering import PER_FILTER, SMCOptions, run_task
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.second_opinion import Evidence, bound_doubt, scatter_doubt
from invdyn.inference.methods.laplace import laplace
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.models.divergence import Diverged

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
    or_linearised: bool = False,
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
        or_linearised: answer by :func:`.laplace.laplace`, in doubt, where filters cannot follow and it stands; for a
            model that says where its paths lie.

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
    path = start if chosen.smoother is None else chosen.smoother.path
    linearised = partial(_linearised, problem, settings, options=options, start=path, seed=seed)
    if or_linearised and (expected := chosen.expected) is not None and (few := scatter_doubt(expected)):
        if (found := linearised(expected, few)) is not None:
            return found
        or_linearised = False
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
    usable = evidence.usable or not or_linearised
    if not usable and (found := linearised(evidence, evidence.reason)) is not None:
        return found
    dropped = torch.empty(0)  # the particles stay where they were made
    result = FilterResult(**joined, states=dropped, log_weights=dropped, log_twist=None, ancestors=dropped, before=None)
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


def _linearised(
    problem: StateSpaceProblem, settings: dict | None, filters: Evidence, why: str, **arguments: Any
) -> az.InferenceData | None:
    """Posterior of the linearised model, in doubt; None where it did not settle, or is not where ``filters`` are."""
    doubt = (
        f"particle filters cannot follow this recording ({why.partition(':')[0]}): this is the Gaussian posterior of "
        "the linearised model, which settled; it rounds what jumps, as forces where a contact begins"
    )
    noted = {**(settings or {}), "in_doubt": [doubt, *(settings or {}).get("in_doubt", [])]}
    with suppress(Diverged):
        found = laplace(problem, settings=noted, **arguments)
        states = len(problem.observations) * problem.model.state_dim
        if found["sample_stats"].attrs["converged"] and not bound_doubt(found.attrs["log_evidence"], states, filters):
            return found
    return None


def fitted_guide(
    problem: StateSpaceProblem,
    options: SMCOptions,
    start: torch.Tensor | None,
    seed: int,
    checkpoint: Checkpoint | None,
) -> Guide:
    """:func:`.best_guide`, or the one that was kept."""
    if checkpoint is not None and (found := kept(checkpoint, *RECORDS)) is not None:
        return found
    with seeded(derived(seed, PILOTS), options.device):
        guide = best_guide(problem.model, problem.observations, options, start=start)
    if checkpoint is not None:
        keep(checkpoint, guide)
    return guide
