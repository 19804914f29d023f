"""SMC²: particles of parameters, each with a particle filter of its own, through the rows one by one.

Chopin, Jacob & Papaspiliopoulos (2013), "SMC²: an efficient algorithm for sequential analysis of state space models".
N_θ parameters from the prior carry filters of N_x particles. Row t adds

    w_n ← w_n p̂(y_t | y_{0:t−1}, θ_n),     log Ẑ += log Σ_n W_n p̂(y_t | y_{0:t−1}, θ_n)     (unbiased evidence of row t)

Where the ESS of the parameters falls under a share of N_θ they are resampled, and PMMH steps (:mod:`.pmmh`) with the
covariance of the parameters move each of them, together with its filter of the rows so far. Where these steps are
accepted too seldom, log Ẑ is too noisy: new filters of 2 N_x particles take the old ones' place, and parameters weigh

    w_n ← w_n Ẑ_new(θ_n) / Ẑ_old(θ_n)

(§3.6.1 there), which leaves both the evidence and the target. Independent runs weigh Ẑ_g / Σ Ẑ, and their scatter gives
the standard error (:mod:`.nested`).

Shapes: G runs, N_θ parameters z (N_θ, P), filters (N_θ, N_x, D).
"""

import math
from concurrent.futures import Executor
from dataclasses import dataclass

import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import Tensors, distribute
from invdyn.inference.execution.progress import Progress, Report, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.resampling import ess, resample
from invdyn.inference.parameters.filter_bank import FilterBank, GuideOf, run_bank
from invdyn.inference.parameters.posterior import ParameterPosterior, combine_runs
from invdyn.inference.parameters.random_walk import Walkers, metropolis, step_root, weighted_moments
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters, checked
from invdyn.models.state_space import StateSpaceModel
from invdyn.recordings import InputError


@dataclass(frozen=True)
class SMC2Options:
    """Sizes of a run; see :func:`smc2`."""

    num_draws: int
    num_particles: int
    max_particles: int
    num_moves: int
    ess_threshold: float
    min_acceptance: float
    guide: GuideOf
    paths: bool

    def check(self) -> None:
        """Raise InputError for sizes that make no run."""
        if self.num_draws < 2 or min(self.num_particles, self.num_moves) < 1 or not 0 < self.ess_threshold <= 1:
            raise InputError(
                "expected num_draws of 2 or more, at least one particle and move, and an ess_threshold in (0, 1], got "
                f"{self.num_draws}, {self.num_particles}, {self.num_moves} and {self.ess_threshold}"
            )


def smc2(
    model: StateSpaceModel,
    observations: Tensor,
    *,
    num_draws: int = 256,
    num_particles: int = 100,
    max_particles: int = 10_000,
    num_runs: int = 4,
    num_moves: int = 5,
    ess_threshold: float = 0.5,
    min_acceptance: float = 0.15,
    guide: GuideOf = Bootstrap,
    paths: bool = True,
    seed: int = 0,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
) -> ParameterPosterior:
    """Sample the parameters that have priors, and the states; with the evidence of every row.

    Args:
        model: with priors (:meth:`.StateSpaceModel.with_priors`).
        observations: (T, O), NaN where missing.
        num_draws: N_θ parameters of each run.
        num_particles: N_x of each filter at first.
        max_particles: that N_x is not doubled beyond.
        num_runs: G independent runs; one alone has no standard error.
        num_moves: PMMH steps after each resampling of the parameters.
        ess_threshold: share of N_θ under which parameters are resampled.
        min_acceptance: of these steps, under which N_x is doubled.
        guide: makes the filters' guide of a model with many parameter sets.
        paths: whether to keep a trajectory of each draw, and the memory of all rows that it takes.
        seed: of every random number; same seed, same result, for any number of workers.
        progress: called with (rows done, rows, what).
        executor: whose workers do the runs.
        checkpoint: keeps the runs that are done.

    Raises InputError for a model that does not fit its rows, has no priors or does not take many parameter sets at
    once, and for sizes that make no run; SMCFailed when all parameters lose their likelihood at a row; LostWork when
    workers died.
    """
    options = SMC2Options(
        num_draws, num_particles, max_particles, num_moves, ess_threshold, min_acceptance, guide, paths
    )
    options.check()
    if num_runs < 1:
        raise InputError(f"expected at least one run, got {num_runs}")
    space, observations = checked(model, observations)
    parts = distribute(
        run_once,
        [(space, observations, options, derived(seed, number)) for number in range(num_runs)],
        [f"run {number}" for number in range(num_runs)],
        executor=executor,
        checkpoint=checkpoint,
        steps=len(observations),
        progress=stage(progress, "parameters and states"),
    )
    largest = max(int(part.pop("num_particles")) for part in parts)
    return combine_runs("smc2", seed, space, parts, largest)


@torch.no_grad()
def run_once(
    space: UnconstrainedParameters,
    observations: Tensor,
    options: SMC2Options,
    seed: int,
    progress: Report | None = None,
) -> Tensors:
    """One run, from a seed of its own; what :func:`.combine_runs` needs, and the last N_x as "num_particles"."""
    with seeded(seed):
        run = _Run(space, observations, options)
        for t in range(len(observations)):
            run.advance()
            if progress is not None:
                progress(t + 1, len(observations))
        return run.result()


class _Run:
    """Parameters, their weights and their filters after some rows."""

    def __init__(self, space: UnconstrainedParameters, observations: Tensor, options: SMC2Options):
        self.space, self.rows, self.options = space, observations.unbind(), options
        self.num_particles = options.num_particles
        self.z = space.draw((options.num_draws,))
        self.log_weights = self.z.new_full((options.num_draws,), -math.log(options.num_draws))
        self.bank = FilterBank(options.num_draws, self.num_particles, keep=options.paths)
        self.guide = options.guide(space.at(self.z))
        self.increments: list[Tensor] = []
        self.acceptance: list[Tensor] = []

    def advance(self) -> None:
        """Enter the next row, and move the parameters where their weights are too uneven."""
        row = self.bank.row
        log_weights = self.log_weights + self.bank.advance(self.guide, self.rows[row])
        total = log_weights.logsumexp(0)
        if not math.isfinite(total.item()):
            raise SMCFailed(
                f"all parameters have likelihood zero at row {row}: the observation is out of the model's reach; use "
                "more particles, more draws or a wider prior"
            )
        self.increments.append(total)
        self.log_weights = log_weights - total
        if ess(self.log_weights) < self.options.ess_threshold * self.options.num_draws:
            self._rejuvenate()

    def _rejuvenate(self) -> None:
        """Resample the parameters and move them by PMMH steps; double N_x where these are accepted too seldom."""
        _, covariance = weighted_moments(self.z, self.log_weights)
        index = resample(self.log_weights.unsqueeze(0))[0]
        self.z = self.z[index]
        self.bank.select(index)
        self.log_weights = torch.full_like(self.log_weights, -math.log(len(index)))

        walkers = Walkers(self.z, self.space.log_prior(self.z), self.bank.log_evidence)
        chances = []
        for _ in range(self.options.num_moves):
            proposed: list[FilterBank] = []

            def log_likelihood(z: Tensor, proposed: list[FilterBank] = proposed) -> Tensor:
                proposed.append(self._filters(z))
                return proposed[0].log_evidence

            walkers, moved, chance = metropolis(walkers, step_root(covariance), self.space.log_prior, log_likelihood)
            self.bank.exchange(moved, proposed[0])
            chances.append(chance.mean())
            # A weighted cloud of few parameters says little of the covariance; the moved ones say more.
            _, covariance = weighted_moments(walkers.z, self.log_weights)
        self.z = walkers.z
        self.acceptance.append(torch.stack(chances).mean())

        enough = 2 * self.num_particles <= self.options.max_particles
        if self.acceptance[-1] < self.options.min_acceptance and enough:
            self._double()
        self.guide = self.options.guide(self.space.at(self.z))

    def _double(self) -> None:
        """Filters of twice as many particles in the place of the present ones."""
        self.num_particles *= 2
        bank = self._filters(self.z)
        log_weights = self.log_weights + bank.log_evidence - self.bank.log_evidence
        total = log_weights.logsumexp(0)
        if math.isfinite(total.item()):
            self.log_weights, self.bank = log_weights - total, bank
        else:
            self.num_particles //= 2

    def _filters(self, z: Tensor) -> FilterBank:
        """Filters of the rows so far at parameters z (N_θ, P)."""
        rows = self.rows[: self.bank.row]
        options = self.options
        return run_bank(self.space.at(z), rows, len(z), self.num_particles, guide=options.guide, keep=options.paths)

    def result(self) -> Tensors:
        """See :func:`run_once`."""
        increments = torch.stack(self.increments)
        found = {
            "z": self.z,
            "log_weights": self.log_weights,
            "log_likelihood": self.bank.log_evidence,
            "log_evidence": increments.sum(),
            "log_evidence_increment": increments,
            "acceptance": torch.stack(self.acceptance).mean() if self.acceptance else increments.new_tensor(math.nan),
            "num_particles": torch.tensor(self.num_particles),
        }
        if self.options.paths:
            found["paths"] = self.bank.draw_paths()
        return found
