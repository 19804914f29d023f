"""Particle Gibbs as a method: chains of :mod:`invdyn.inference.mcmc.particle_gibbs`, shared out among workers."""

from concurrent.futures import Executor
from dataclasses import replace
from itertools import accumulate

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import distribute, inside
from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import Guide
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.mcmc.mixing import mixing
from invdyn.inference.mcmc.particle_gibbs import run_chains
from invdyn.inference.methods.smc import FILTERS, PREDICTIVE, fitted_guide
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.recordings import InputError


def particle_gibbs(
    problem: StateSpaceProblem,
    *,
    guide: str = "controlled",
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    warmup: int = 10,
    thin: int = 3,
) -> az.InferenceData:
    """Sample the posterior by particle Gibbs; no evidence (NaN).

    Args are those of :func:`.smc.smc`, and:
        options: num_filters chains of num_draws draws each; num_particles of every sweep.
        executor: whose workers run the chains, ``options.filters_per_task`` at a time; the guide is fitted here.
        checkpoint: keeps the guide and the chains that are done, and continues from there.
        warmup, thin: sweeps that are thrown away at first, and sweeps from one draw to the next.

    The attributes of sample_stats hold the largest R-hat and the smallest effective sample sizes of any number
    that the problem monitors, over all sweeps after the warm-up. Raises InputError for fewer than 2 particles, or a
    body that is uncertain; LostWork when a task's workers died each time.
    """
    options = options or SMCOptions()
    if options.num_particles < 2:
        raise InputError(
            f"particle Gibbs needs at least 2 particles, one of them the last path: got {options.num_particles}"
        )
    if problem.uncertain:
        raise InputError(
            f"particle Gibbs takes parameters as known, and {', '.join(problem.uncertain)} is uncertain: drop its "
            "priors and [uncertainty], or use smc"
        )
    options.check()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    checkpoint = inside(checkpoint, f"particle-gibbs-{guide}")
    chosen = Guide("bootstrap", None, options.num_particles)
    if guide == "controlled":
        chosen = fitted_guide(problem, options, start, seed, inside(checkpoint, "guide"))
    sweeps, sizes = warmup + thin * options.num_draws, options.tasks()
    parts = distribute(
        run_chains,
        [
            (
                model,
                observations,
                replace(options, num_filters=size),
                chosen.smoother,
                derived(seed, FILTERS, k),
                warmup,
                sweeps,
                chosen.name,
            )
            for k, size in enumerate(sizes)
        ],
        [f"chains {end - size} to {end - 1}" for size, end in zip(sizes, accumulate(sizes), strict=True)],
        executor=executor,
        checkpoint=checkpoint,
        steps=sweeps,
        progress=stage(progress, "sweep"),
    )
    kept = torch.cat([part["paths"] for part in parts])
    with seeded(derived(seed, PREDICTIVE)), torch.no_grad():
        return to_inference_data(
            problem,
            kept[:, thin - 1 :: thin],
            method="particle-gibbs",
            seed=seed,
            settings={
                **(settings or {}),
                "num_particles": options.num_particles,
                "filters_per_task": sizes[0],
                "warmup": warmup,
                "thin": thin,
            },
            diagnostics=mixing(problem.monitored(kept)),
        )
