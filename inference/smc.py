"""SMC as a method: filters, the outer sampler and smoothing, from a problem to InferenceData.

Biderman et al. (2020) with two changes: the guide looks ahead (:mod:`.controlled`), and what is
reported is the smoothed posterior (:mod:`.smoothing`), not the filter.
"""

from collections.abc import Callable
from dataclasses import dataclass

import arviz as az
import torch

from invdyn.inference.bootstrap import Bootstrap
from invdyn.inference.controlled import Controlled
from invdyn.inference.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.initialise import Problem
from invdyn.inference.particle_filter import FilterResult, ParticleFilter
from invdyn.inference.posterior import to_inference_data
from invdyn.inference.posterior_linearisation import posterior_linearisation
from invdyn.inference.smoothing import backward_simulation
from invdyn.models import StateSpaceModel

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class SMCOptions:
    """M filters, N particles each, R smoothed trajectories of each."""

    num_filters: int = 64
    num_particles: int = 100
    num_draws: int = 4
    ess_threshold: float = 0.5
    resampling: str = "systematic"
    dtype: torch.dtype = torch.float32
    device: str = "cpu"


def gaussian_smoother(model: StateSpaceModel, observations: torch.Tensor, start=None) -> GaussianSmoother:
    """Gauss–Newton, then linearised over the posterior: what the controlled guide and the smoother use."""
    smoother = gauss_newton(model, observations, start=start)
    return posterior_linearisation(model, observations, smoother)


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
    fast = model.to(dtype=options.dtype, device=options.device)
    rows = observations.to(dtype=options.dtype, device=options.device)
    if guide == "bootstrap":
        proposal = Bootstrap(fast)
    else:
        proposal = Controlled(fast, observations, smoother or gaussian_smoother(model, observations))
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
        smoother = gaussian_smoother(model, observations, start)
        result = run_filters(
            model, observations, options, guide=guide, smoother=smoother, progress=stage("filter")
        )
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
