"""The Gaussian smoother alone, as a method: fast, and exact for linear-Gaussian models.

Draws are exact ones of the linearised model's posterior (:class:`.gaussian_chain.GaussianChain`); the evidence is
that model's.
"""

import warnings
from dataclasses import replace

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.best_guide import has_own_start, look_ahead_opinion, second_opinion
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.second_opinion import linearisation_doubt
from invdyn.inference.posterior.posterior import stored_dtype, to_inference_data
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.linearised import gaussian_smoother

MAX_NUMBERS, MIN_PATHS = 32_000_000, 64
"""Of drawn states at most, but for that many paths: 256 paths of the plane's six states up to 20,000 rows."""


def laplace(
    problem: StateSpaceProblem,
    *,
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Posterior and evidence of the linearised model.

    Arguments are those of :func:`.smc.smc`; num_filters × num_draws are the chains × draws of the result, all
    independent. Of a very long recording there are fewer, at most ``MAX_NUMBERS`` numbers, and a warning says so.

    Where a model has no start of its own (:meth:`.StateSpaceModel.initial_paths`) the linearisation may end in a wrong
    mode, or be of another model, as where the noise depends on the state. Two pilots give a second opinion: bootstrap
    filters, which see any mode, and filters that the smoother guides, whose error is small. The attributes "usable"
    and "doubt" of sample_stats say whether the evidence stands.
    """
    model, rows = problem.model, problem.observations
    options = _within_memory(options or SMCOptions(), len(rows) * model.state_dim)
    smoother = gaussian_smoother(model, rows, start)
    opinion: dict[str, int | str] = {}
    if start is None and not has_own_start(model):
        bootstrap = second_opinion(model, rows, options, seed)
        ahead = look_ahead_opinion(model, rows, options, seed, smoother)
        doubt = linearisation_doubt(smoother.log_evidence.item(), bootstrap, ahead)
        opinion = {"usable": int(not doubt), "doubt": doubt}
    with seeded(seed), torch.no_grad():
        count = (options.num_filters, options.num_draws)
        paths = GaussianChain.of(smoother).sample(count, dtype=stored_dtype(*count, *smoother.path.shape))
        if progress is not None:
            progress(1, 1, "smooth")
        return to_inference_data(
            problem,
            paths,
            method="laplace",
            seed=seed,
            settings=settings or {},
            log_evidence=smoother.log_evidence.item(),
            diagnostics={"converged": int(smoother.converged), **opinion},
        )


def _within_memory(options: SMCOptions, numbers: int) -> SMCOptions:
    """Options with fewer paths, each of so many ``numbers``, where they are too many to keep."""
    wanted = options.num_filters * options.num_draws
    draws = max(1, max(MAX_NUMBERS // numbers, MIN_PATHS) // options.num_filters)
    if draws >= options.num_draws or wanted <= MIN_PATHS:
        return options
    warnings.warn(
        f"laplace draws {draws * options.num_filters} paths of this long recording, of {wanted}: "
        "infer parts of it for more",
        stacklevel=3,
    )
    return replace(options, num_draws=draws)
