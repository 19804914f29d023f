"""SMC as a method: filters, the outer sampler and smoothing, from a problem to InferenceData.

Biderman et al. (2020) with two changes: the guide looks ahead (:mod:`.controlled`), and what is
reported is the smoothed posterior (:mod:`.smoothing`), not the filter.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import arviz as az
import torch

from invdyn.inference.bootstrap import Bootstrap
from invdyn.inference.controlled import Controlled
from invdyn.inference.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.initialise import Problem
from invdyn.inference.iterated import iterate
from invdyn.inference.particle_filter import ParticleFilter
from invdyn.inference.particles import FilterResult
from invdyn.inference.posterior import to_inference_data
from invdyn.inference.posterior_linearisation import posterior_linearisation
from invdyn.inference.smoothing import backward_simulation
from invdyn.models import StateSpaceModel

Progress = Callable[[int, int, str], None]

PILOT_PARTICLE_STEPS = 4e6
"""Particles × rows that the pilot runs of a refit keep, at most."""


@dataclass(frozen=True)
class SMCOptions:
    """M filters, N particles each, R smoothed trajectories of each.

    The controlled guide is refitted ``refits`` times on pilot runs; 0 takes the linearised model's
    factors as they are. ``dtype`` None means float32 particles where that is precise enough
    (:func:`sufficient_dtype`), else float64.
    """

    num_filters: int = 64
    num_particles: int = 100
    num_draws: int = 4
    refits: int = 2
    ess_threshold: float = 0.5
    resampling: str = "systematic"
    dtype: torch.dtype | None = None
    device: str = "cpu"


def gaussian_smoother(model: StateSpaceModel, observations: torch.Tensor, start=None) -> GaussianSmoother:
    """Gauss–Newton, then linearised over the posterior."""
    smoother = gauss_newton(model, observations, start=start)
    return posterior_linearisation(model, observations, smoother)


def adapted_smoother(
    model: StateSpaceModel, observations: torch.Tensor, options: SMCOptions, start=None
) -> GaussianSmoother:
    """What the controlled guide and the smoother use: factors refitted on pilot runs (:mod:`.iterated`).

    The start is Gauss–Newton's linearisation at the mode or one over the posterior, whichever
    guides the steadier filters. Random numbers are torch's own (global seed).
    """
    mode = gauss_newton(model, observations, start=start)
    around = posterior_linearisation(model, observations, mode)
    if options.refits == 0 or options.num_filters == 1:
        return around

    # Enough particles to fit a quadratic to, and no more than memory holds for every row.
    room = int(PILOT_PARTICLE_STEPS / (options.num_filters * len(observations)))
    few = replace(options, num_particles=min(options.num_particles, 100, max(room, 16)))

    def pilot(smoother: GaussianSmoother) -> FilterResult:
        return run_filters(model, observations, few, smoother=smoother)

    return iterate(model, observations, [mode, around], pilot, iterations=options.refits)


def sufficient_dtype(smoother: GaussianSmoother) -> torch.dtype:
    """float32 if its rounding of the states stays under a hundredth of their posterior sd everywhere, else float64."""
    sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    rounding = torch.finfo(torch.float32).eps * smoother.path.abs()
    return torch.float32 if bool((rounding < 0.01 * sd).all()) else torch.float64


def run_filters(
    model: StateSpaceModel,
    observations: torch.Tensor,
    options: SMCOptions,
    *,
    guide: str = "controlled",
    smoother: GaussianSmoother | None = None,
    keep: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FilterResult:
    """Run M filters with ``guide`` "controlled" or "bootstrap"; see :meth:`ParticleFilter.run`."""
    if guide == "controlled" and smoother is None:
        smoother = adapted_smoother(model, observations, options)
    dtype = options.dtype or (torch.float32 if smoother is None else sufficient_dtype(smoother))
    fast = model.to(dtype=dtype, device=options.device)
    rows = observations.to(dtype=dtype, device=options.device)
    proposal = Bootstrap(fast) if smoother is None or guide == "bootstrap" else Controlled(fast, observations, smoother)
    particle_filter = ParticleFilter(
        fast,
        proposal,
        options.num_particles,
        num_filters=options.num_filters,
        ess_threshold=options.ess_threshold,
        resampling=options.resampling,
    )
    return particle_filter.run(rows, keep=keep, progress=progress)


def smc(
    problem: Problem,
    *,
    guide: str = "controlled",
    options: SMCOptions | None = None,
    start: torch.Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Nested SMC with smoothing.

    Args:
        problem: model and observations.
        guide: "controlled" or "bootstrap".
        options: sizes.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
    """
    options = options or SMCOptions()
    model, observations = problem.model, problem.observations

    def stage(what: str):
        return None if progress is None else lambda done, total: progress(done, total, what)

    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        smoother = None
        if guide == "controlled":
            smoother = adapted_smoother(model, observations, options, start)
        result = run_filters(model, observations, options, guide=guide, smoother=smoother, progress=stage("filter"))
        paths = backward_simulation(
            model, result, observations, options.num_draws, smoother=smoother, progress=stage("smooth")
        )
        return to_inference_data(
            problem,
            paths,
            result,
            method="smc" if guide == "controlled" else guide,
            seed=seed,
            settings={
                **(settings or {}),
                "num_filters": options.num_filters,
                "num_particles": options.num_particles,
                "resampling": options.resampling,
            },
        )
