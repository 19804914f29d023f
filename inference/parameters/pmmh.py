"""Particle marginal Metropolis–Hastings: parameters, and states with them, by a random walk on estimated likelihoods.

Andrieu, Doucet & Holenstein (2010), "Particle Markov chain Monte Carlo methods", §2.4.2. A step proposes z' near z,
runs a particle filter at θ' = T(z'), and accepts with probability

    min(1, p(z') Ẑ(θ') / (p(z) Ẑ(θ)));

with θ' it takes one trajectory of that filter, drawn by weight, so that pairs (θ, x) have the exact posterior for any
number of particles. Chains run as one batch of filters. They start at draws from the prior, weighted by p̂(y | θ)^λ with
the exponent λ that leaves as many effective draws as there are chains: dispersed, and nowhere impossible.

N, if not given, makes the sd of log Ẑ about 1.2 at a central parameter (Pitt et al. 2012; Doucet et al. 2015): its
variance falls as 1/N, so that N ← N (sd/1.2)² until the sd lies in (1, 1.5). The first half of the warm-up finds the
central parameter; the second half adapts the walk with the N that was chosen.

The evidence comes by importance sampling squared (:mod:`.importance`). Where the sd of log Ẑ stays above 2.5 nats the
result is not usable: "usable" is 0 among its statistics, and the evidence has no standard error.

Shapes: S recordings (one for :func:`pmmh`), C chains of each, z (S, C, P).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.resampling import categorical
from invdyn.inference.parameters.filter_bank import GuideOf, run_bank
from invdyn.inference.parameters.importance import importance_evidence
from invdyn.inference.parameters.posterior import ParameterPosterior
from invdyn.inference.parameters.random_walk import Adaptation, Walkers, metropolis
from invdyn.inference.parameters.tempered import tempering_step
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters, checked
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings import InputError

CHAIN, EVIDENCE = range(2)
"""Places of the random numbers of one run (:func:`.seeds.derived`)."""

STARTS = 10
"""Draws from the prior for each chain that starts at one of them."""
SD_TARGET, SD_RANGE = 1.2, (1.0, 1.5)
"""Standard deviation of log Ẑ, nats, that the number of particles aims at, and where it is left."""
SD_FILTERS, SD_TRIALS = 64, 6
"""Filters that the sd is measured with, and numbers of particles that are tried, at most."""
NOISE_LIMIT = 2.5
"""Standard deviation σ of log Ẑ, nats, beyond which the chains stick and e^σ² draws do not average the noise out."""
FIRST_PARTICLES, MIN_PARTICLES, MAX_PARTICLES = 100, 10, 100_000
"""Of a filter, where no number is given."""


@dataclass(frozen=True)
class Chains:
    """Kept draws of S × C chains: z (S, C, R, P), log-likelihoods (S, C, R), paths (S, C, R, T, D) or None.

    ``acceptance`` (S, C) is of kept draws; ``log_evidence_sd`` (S,) of log Ẑ at each group's central parameter.
    """

    z: Tensor
    log_likelihood: Tensor
    paths: Tensor | None
    acceptance: Tensor
    num_particles: int
    log_evidence_sd: Tensor


def pmmh(
    model: StateSpaceModel,
    observations: Tensor,
    *,
    num_chains: int = 8,
    num_draws: int = 500,
    num_warmup: int = 500,
    num_particles: int | None = None,
    target_acceptance: float = 0.2,
    evidence_draws: int = 1000,
    guide: GuideOf = Bootstrap,
    paths: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
) -> ParameterPosterior:
    """Sample the parameters that have priors, and the states.

    Args:
        model: with priors (:meth:`.StateSpaceModel.with_priors`).
        observations: (T, O), NaN where missing.
        num_chains, num_draws, num_warmup: C chains, draws of each that are kept, and steps before them.
        num_particles: N of each filter; None chooses it.
        target_acceptance: that the walk adapts to; the noise of log Ẑ makes it lower than for an exact likelihood.
        evidence_draws: of the importance sampler for the evidence; 0 leaves the evidence NaN.
        guide: makes the filters' guide of a model with many parameter sets.
        paths: whether to keep a trajectory of each draw.
        seed: of every random number; same seed, same result.
        progress: called with (steps done, steps, what).

    Raises InputError for a model that does not fit its rows, has no priors or does not take many parameter sets at
    once, and for sizes under one; SMCFailed when no draw from the prior gives the observations a density.
    """
    if min(num_chains, num_draws, num_warmup) < 1 or (num_particles is not None and num_particles < 1):
        raise InputError("expected at least one chain, draw, warm-up step and particle")
    space, observations = checked(model, observations)
    with seeded(derived(seed, CHAIN)):
        found = run_chains(
            space,
            observations.unsqueeze(0),
            num_chains=num_chains,
            num_draws=num_draws,
            num_warmup=num_warmup,
            num_particles=num_particles,
            target_acceptance=target_acceptance,
            guide=guide,
            paths=paths,
            progress=progress,
        )
    z = found.z[0]
    evidence, evidence_sd = math.nan, math.nan
    if evidence_draws > 0:

        def log_likelihood(proposed: Tensor) -> Tensor:
            size = len(proposed)
            return run_bank(space.at(proposed), observations, size, found.num_particles, guide=guide).log_evidence

        with seeded(derived(seed, EVIDENCE)):
            evidence, evidence_sd = importance_evidence(space, z.flatten(0, 1), log_likelihood, evidence_draws)
    scatter = found.log_evidence_sd.item()
    usable = scatter < NOISE_LIMIT
    doubt = "" if usable else f"log Ẑ scatters by {scatter:.1f} nats at one parameter: use more particles"
    return ParameterPosterior(
        method="pmmh",
        seed=seed,
        draws=space.values(z),
        log_weights=torch.full(z.shape[:-1], -math.log(num_chains * num_draws), dtype=torch.float64),
        log_likelihood=found.log_likelihood[0],
        acceptance=found.acceptance[0],
        log_evidence=evidence,
        log_evidence_sd=evidence_sd if usable else math.nan,
        paths=None if found.paths is None else found.paths[0],
        num_particles=found.num_particles,
        statistics={"log_likelihood_sd": scatter, "usable": int(usable), "doubt": doubt},
    )


@torch.no_grad()
def run_chains(
    space: UnconstrainedParameters,
    observations: Tensor,
    *,
    num_chains: int,
    num_draws: int,
    num_warmup: int,
    num_particles: int | None,
    target_acceptance: float = 0.2,
    guide: GuideOf = Bootstrap,
    paths: bool = True,
    progress: Progress | None = None,
) -> Chains:
    """C chains for each of S recordings, by torch's global generator; adaptation is each recording's own.

    Args:
        observations: (S, T, O); complete if S > 1.

    Other arguments and what is raised as for :func:`pmmh`.
    """
    report = stage(progress, "walk")
    groups = len(observations)

    def estimate(particles: int, chains: int, keep: bool = False) -> "_Estimate":
        return _Estimate(space, _rows(observations, chains), particles, guide, keep)

    first = num_particles or FIRST_PARTICLES
    walkers = _start(space, estimate(first, STARTS * num_chains), groups, num_chains)
    adaptation = Adaptation(walkers.z, target_acceptance)
    likelihood = estimate(first, num_chains)
    steps, half, sd = num_warmup + num_draws, num_warmup // 2, torch.zeros(groups)

    kept: list[tuple[Tensor, Tensor]] = []
    lines = None
    trajectories: list[Tensor] = []
    accepted = walkers.z.new_zeros(walkers.z.shape[:-1])
    for step in range(steps):
        if step == half:
            central = adaptation.mean
            first, sd = _choose_particles(central, lambda n: estimate(n, SD_FILTERS), first, num_particles is None)
            likelihood = estimate(first, num_chains)
            walkers = Walkers(walkers.z, walkers.log_prior, likelihood(walkers.z))
        if step == num_warmup:
            likelihood = estimate(first, num_chains, keep=paths)
            # The states at the last draw of the warm-up: again from a filter, as its own were not kept.
            walkers = Walkers(walkers.z, walkers.log_prior, likelihood(walkers.z))
            lines = likelihood.paths() if paths else None

        walkers, moved, chance = metropolis(walkers, adaptation.root(), space.log_prior, likelihood)
        if step < num_warmup:
            adaptation.update(walkers.z, chance)
        else:
            accepted += moved
            kept.append((walkers.z, walkers.log_likelihood))
            if lines is not None:
                lines = torch.where(moved.reshape(*moved.shape, 1, 1), likelihood.paths(), lines)
                trajectories.append(lines)
        if report is not None:
            report(step + 1, steps)
    return Chains(
        torch.stack([z for z, _ in kept], 2),
        torch.stack([value for _, value in kept], 2),
        torch.stack(trajectories, 2) if trajectories else None,
        accepted / num_draws,
        first,
        sd,
    )


class _Estimate:
    """Log Ẑ (S, C) at z (S, C, P), of one bank of filters; the last bank's trajectories if they are kept."""

    def __init__(
        self, space: UnconstrainedParameters, rows: Sequence[Tensor], particles: int, guide: GuideOf, keep: bool
    ):
        self.space, self.rows, self.particles, self.guide, self.keep = space, rows, particles, guide, keep

    def __call__(self, z: Tensor) -> Tensor:
        self._shape = z.shape[:-1]
        sets = z.flatten(0, 1)
        self._bank = run_bank(
            self.space.at(sets), self.rows, len(sets), self.particles, guide=self.guide, keep=self.keep
        )
        return self._bank.log_evidence.reshape(self._shape)

    def paths(self) -> Tensor:
        """Trajectories (S, C, T, D), one of each filter."""
        return self._bank.draw_paths().unflatten(0, self._shape)


def _rows(observations: Tensor, chains: int) -> Sequence[Tensor]:
    """Rows (O,) of one recording, or (S C, 1, O) of several, each for its own chains; observations (S, T, O)."""
    if len(observations) == 1:
        return observations[0].unbind()
    return observations.repeat_interleave(chains, 0).unsqueeze(-2).unbind(1)


def _start(space: UnconstrainedParameters, likelihood: _Estimate, groups: int, chains: int) -> Walkers:
    """Draws from the prior, chosen by p̂(y | θ)^λ with as many effective draws as chains."""
    z = space.draw((groups, STARTS * chains))
    log_likelihood = likelihood(z)
    if not bool(torch.isfinite(log_likelihood).any(-1).all()):
        raise SMCFailed(
            f"none of {STARTS * chains} draws from the prior gives the observations a density: "
            "use more particles, more chains or a narrower prior"
        )
    exponent = tempering_step(log_likelihood, torch.zeros(groups, dtype=torch.float64), chains)
    log_weights = exponent.unsqueeze(-1) * log_likelihood
    index = categorical(log_weights.unsqueeze(-2).expand(-1, chains, -1))
    z = z.gather(1, index.unsqueeze(-1).expand(-1, -1, space.size))
    return Walkers(z, space.log_prior(z), log_likelihood.gather(1, index))


def _choose_particles(
    central: Tensor, estimate: Callable[[int], _Estimate], particles: int, free: bool
) -> tuple[int, Tensor]:
    """A number of particles, and the sd (S,) of log Ẑ with it at ``central`` (S, P).

    Where it is not free it stays. The median over recordings decides; an infinite sd asks for four times as many.
    """
    z = central.unsqueeze(1).expand(-1, SD_FILTERS, -1)
    for _ in range(SD_TRIALS):
        sd = estimate(particles)(z).std(-1).nan_to_num(nan=math.inf)
        typical = sd.median().item()
        if not free or SD_RANGE[0] <= typical <= SD_RANGE[1]:
            break
        wanted = particles * min(4.0, (typical / SD_TARGET) ** 2)
        wanted = min(max(MIN_PARTICLES, math.ceil(wanted)), MAX_PARTICLES)
        if wanted == particles:
            break
        particles = wanted
    return particles, sd
