"""Tempered SMC for static parameters: from the prior to the posterior through powers of the likelihood, waste-free.

    π_λ(z) ∝ p(z) L(z)^λ,   0 = λ_0 < λ_1 < … < 1,     log Ẑ += log (1/N) Σ_n L(z_n)^{λ_k − λ_{k−1}}

(Neal 2001; Del Moral, Doucet & Jasra 2006). Each λ_k leaves an ESS of half the particles (Jasra et al. 2011).
Waste-free (Dau & Chopin 2022, "Waste-free sequential Monte Carlo", algorithm 2): of N = M K particles M are resampled,
each starts a chain of K − 1 random-walk steps that leave π_{λ_k} invariant, and all M K states are the next particles.

L may be an unbiased estimate, such as a particle filter's: then particles are pairs of z and the estimate's random
numbers, and the last distribution has the exact posterior of z as its margin (Duan & Fulop 2015, "Density-tempered
marginalized sequential Monte Carlo samplers").

Independent runs weigh Ẑ_g / Σ Ẑ; their scatter gives the standard error (:mod:`.nested`).

Shapes: G runs, N particles, z (N, P).
"""

import math
from collections.abc import Callable
from concurrent.futures import Executor

import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import Tensors, distribute
from invdyn.inference.execution.progress import Progress, Report, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.resampling import ess, resample
from invdyn.inference.parameters.filter_bank import GuideOf, run_bank
from invdyn.inference.parameters.posterior import ParameterPosterior, combine_runs
from invdyn.inference.parameters.random_walk import Walkers, metropolis, step_root, weighted_moments
from invdyn.inference.parameters.unconstrained import M, UnconstrainedParameters
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings import InputError

LikelihoodOf = Callable[[M], Tensor]
"""Log p(y | θ) (M,) of a model with M parameter sets (M, 1, own shape), or the logarithm of unbiased estimates."""


class ParticleLikelihood:
    """Log Ẑ (M,) of ``observations`` (T, O) by filters of ``num_particles``, as a :data:`LikelihoodOf`."""

    def __init__(self, observations: Tensor, num_particles: int, guide: GuideOf = Bootstrap):
        self.observations, self.num_particles, self.guide = observations, num_particles, guide

    def __call__(self, model: StateSpaceModel) -> Tensor:
        """Of each parameter set of the model, −∞ where it is impossible."""
        sets = len(next(iter(model.parameters[name] for name in model.priors)))
        rows = self.observations.to(model.dtype)
        return run_bank(model, rows, sets, self.num_particles, guide=self.guide).log_evidence


def tempered(
    model: M,
    log_likelihood: LikelihoodOf[M],
    *,
    num_draws: int = 1000,
    chain_length: int = 20,
    num_runs: int = 4,
    ess_threshold: float = 0.5,
    seed: int = 0,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
) -> ParameterPosterior:
    """Sample the parameters that have priors.

    Args:
        model: with priors (:meth:`.StateSpaceModel.with_priors`).
        log_likelihood: of the model at many parameter sets; :class:`ParticleLikelihood` for any model.
        num_draws: N of each run, a multiple of the chain length.
        chain_length: K states of each waste-free chain, its start among them.
        num_runs: G independent runs; one alone has no standard error.
        ess_threshold: share of N that the ESS is left at by each step of λ.
        seed: of every random number; same seed, same result, for any number of workers.
        progress: called with (runs done, runs, what).
        executor: whose workers do the runs.
        checkpoint: keeps the runs that are done.

    Raises InputError for a model without priors or sizes that do not fit; SMCFailed when no draw has a likelihood;
    LostWork when workers died.
    """
    if chain_length < 2 or num_draws % chain_length or num_draws < 2 * chain_length or num_runs < 1:
        raise InputError(
            f"expected num_draws a multiple of chain_length, twice it at least, chain_length ≥ 2 and num_runs ≥ 1, "
            f"got {num_draws}, {chain_length} and {num_runs}"
        )
    space = UnconstrainedParameters(model)
    parts = distribute(
        _run,
        [
            (space, log_likelihood, num_draws, chain_length, ess_threshold, derived(seed, number))
            for number in range(num_runs)
        ],
        [f"run {number}" for number in range(num_runs)],
        executor=executor,
        checkpoint=checkpoint,
        progress=stage(progress, "temper"),
    )
    return combine_runs("tempered", seed, space, parts)


@torch.no_grad()
def _run(
    space: UnconstrainedParameters,
    likelihood_of: LikelihoodOf,
    num_draws: int,
    chain_length: int,
    ess_threshold: float,
    seed: int,
    progress: Report | None = None,
) -> Tensors:
    """One run, from a seed of its own: equally weighted draws at λ = 1."""

    def log_likelihood(z: Tensor) -> Tensor:
        return likelihood_of(space.at(z)).double().nan_to_num(nan=-torch.inf, posinf=torch.inf, neginf=-torch.inf)

    with seeded(seed):
        z = space.draw((num_draws,))
        particles = Walkers(z, space.log_prior(z), log_likelihood(z))
        exponent, log_evidence = torch.zeros((), dtype=torch.float64), torch.zeros((), dtype=torch.float64)
        acceptance = torch.zeros((), dtype=torch.float64)
        while exponent < 1:
            if not bool(torch.isfinite(particles.log_likelihood).any()):
                raise SMCFailed(f"none of {num_draws} draws from the prior has a likelihood: use a narrower prior")
            after = tempering_step(particles.log_likelihood, exponent, ess_threshold * num_draws)
            log_weights = (after - exponent) * particles.log_likelihood
            log_evidence = log_evidence + log_weights.logsumexp(0) - math.log(num_draws)
            exponent = after

            _, covariance = weighted_moments(particles.z, log_weights)
            root = step_root(covariance)
            particles, acceptance = _waste_free(
                particles, log_weights, chain_length, root, space, log_likelihood, exponent
            )
    return {
        "z": particles.z,
        "log_weights": torch.full((num_draws,), -math.log(num_draws), dtype=torch.float64),
        "log_likelihood": particles.log_likelihood,
        "log_evidence": log_evidence,
        "acceptance": acceptance,
    }


def _waste_free(
    particles: Walkers,
    log_weights: Tensor,
    chain_length: int,
    root: Tensor,
    space: UnconstrainedParameters,
    log_likelihood: Callable[[Tensor], Tensor],
    exponent: Tensor,
) -> tuple[Walkers, Tensor]:
    """N particles of π_λ from N weighted ones, and the acceptance of the chains' steps."""
    index = _ancestors(log_weights, len(particles.z) // chain_length)
    walkers = Walkers(*(each[index] for each in particles))
    states, chances = [walkers], []
    for _ in range(chain_length - 1):
        walkers, _, chance = metropolis(walkers, root, space.log_prior, log_likelihood, exponent)
        states.append(walkers)
        chances.append(chance.mean())
    return Walkers(*map(torch.cat, zip(*states, strict=True))), torch.stack(chances).mean()


def _ancestors(log_weights: Tensor, count: int) -> Tensor:
    """``count`` ancestors of weighted particles (N,): every (N/count)-th of N systematic ones."""
    every = resample(log_weights.unsqueeze(0))[0]
    stride = len(log_weights) // count
    return every[torch.randint(stride, (1,)) :: stride][:count]


def tempering_step(log_likelihood: Tensor, start: Tensor, size: float) -> Tensor:
    """Largest exponents λ (...) in (start, 1] with an ESS of w ∝ L^(λ − start) not under ``size``, by bisection.

    Draws of likelihood zero drop out at any λ > start: if they leave less than ``size``, λ is next to the start.

    Args:
        log_likelihood: (..., K) of equally weighted draws, −∞ where impossible, not everywhere.
        start: (...) exponents reached so far.
        size: effective number of draws to be left.
    """
    centred = log_likelihood - log_likelihood.amax(-1, keepdim=True)

    def enough(exponent: Tensor) -> Tensor:
        return ess((exponent - start).unsqueeze(-1) * centred) >= size

    low, high = start + 1e-9, torch.ones_like(start)
    whole = enough(high)
    for _ in range(50):
        middle = (low + high) / 2
        fits = enough(middle)
        low, high = torch.where(fits, middle, low), torch.where(fits, high, middle)
    return torch.where(whole, 1.0, low)
