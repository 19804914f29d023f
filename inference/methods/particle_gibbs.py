"""Particle Gibbs with ancestor sampling: a Markov chain of whole paths, exact for any number of particles.

Lindsten, Jordan & Schön (2014), "Particle Gibbs with ancestor sampling", algorithm 2. One sweep runs a particle
filter in which the last particle is held to the path x' of the sweep before. Where that filter resamples, the held
particle's past is drawn anew,

    P(ancestor of x'_t = n) ∝ Ŵ_{t−1}^n p(x'_t | x_{t−1}^n),     Ŵ = W/ψ̃  (the filter without its twist),

so that x' may change its past at every such row, and the new path is the line of one final particle, drawn by
weight. p(x_{0:T} | y_{0:T}) is left invariant for any N ≥ 2 and any guide; N sets how far a sweep moves.

Two things help where the dynamics are nearly deterministic (ε ≪ 1), and p(x'_t | x_{t−1}^n) is zero but for
its own parent, so that ancestor sampling alone changes nothing:

* the controlled guide, whose weights are nearly even: then the filter hardly ever resamples (only below ``threshold``,
  which keeps the invariance: it is a rule of the particles that the sweep conditions on), and a sweep is nearly an
  independent draw;
* after each sweep, Metropolis–Hastings moves of blocks of ℓ states between their neighbours (:mod:`.bridge`), as in
  Lindsten, Bunch, Singh & Schön (2015), but on the path alone.

Shapes: M chains at once, N particles each, paths (M, T, D), float64.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from itertools import accumulate

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import Tensors, inside, spread
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.bridge import Bridge
from invdyn.inference.filters.controlled import Controlled
from invdyn.inference.filters.particles import History, take
from invdyn.inference.filters.proposal import Proposal
from invdyn.inference.filters.resampling import categorical, ess, resample
from invdyn.inference.methods.nuts import mixing
from invdyn.inference.methods.smc import FILTERS, PREDICTIVE, Progress, SMCOptions, fitted_guide
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models import StateSpaceModel
from invdyn.models.observation.missing import observed_log_prob
from invdyn.recordings import InputError

BLOCK = 6


@torch.no_grad()
def sweep(guide: Proposal, observations: Tensor, held: Tensor, num_particles: int, *, threshold: float = 0.5) -> Tensor:
    """Paths (M, T, D) of the next sweep, given those of the sweep before.

    Args:
        guide: of a model whose transition has a density; its ``log_twist`` is used where it has one.
        observations: (T, O), NaN where missing.
        held: (M, T, D) the sweep before.
        num_particles: N, the held one among them; at least 2.
        threshold: resample a filter when its ESS falls below this share of N; 1 is the printed algorithm.
    """
    return _conditional_filter(guide, observations, held, len(held), num_particles, threshold)


@torch.no_grad()
def first_paths(
    guide: Proposal, observations: Tensor, num_chains: int, num_particles: int, *, threshold: float = 0.5
) -> Tensor:
    """Paths (M, T, D) to begin at: lines of particle filters that hold none."""
    return _conditional_filter(guide, observations, None, num_chains, num_particles, threshold)


def _conditional_filter(
    guide: Proposal, observations: Tensor, held: Tensor | None, chains: int, size: int, threshold: float
) -> Tensor:
    model, rows = guide.model, len(observations)
    device = observations.device
    history = History(rows, rows, chains, device)
    log_weights = torch.zeros(chains, size, dtype=torch.float64, device=device)
    itself = torch.arange(size, device=device).expand(chains, size)
    state, twist = None, torch.zeros_like(log_weights)
    for t in range(rows):
        parents = itself
        if t == 0:
            proposal, prior = guide.conditional_initial().expand(torch.Size((chains, size))), model.initial()
        else:
            need = ess(log_weights) < threshold * size
            if bool(need.any()):
                drawn = resample(log_weights, "multinomial")
                if held is not None:
                    # Ancestors come sorted: a random one gives way to the held particle's, not the largest.
                    out = torch.randint(size, (chains, 1), device=device)
                    drawn = drawn.scatter(-1, out, drawn[:, -1:])
                    reach = model.transition(state, t).log_prob(held[:, t].unsqueeze(-2))
                    drawn[:, -1] = categorical(log_weights - twist + reach)
                parents = torch.where(need.unsqueeze(-1), drawn, itself)
                state, twist = take(state, parents), twist.gather(-1, parents)
                log_weights = torch.where(need.unsqueeze(-1), 0.0, log_weights)
            proposal, prior = guide.conditional(t, state), model.transition(state, t)
        state = proposal.sample()
        if held is not None:
            state[:, -1] = held[:, t]
        increment = prior.log_prob(state) - proposal.log_prob(state)
        if bool((~torch.isnan(observations[t])).any()):
            increment = increment + observed_log_prob(model.emission(state, t), observations[t])
        if hasattr(guide, "log_twist"):
            before, twist = twist, guide.log_twist({"x": state}, t)
            increment = increment + twist - before
        log_weights = log_weights + increment.double()
        log_weights = torch.where(torch.isnan(log_weights), -torch.inf, log_weights)
        log_weights = log_weights - log_weights.logsumexp(-1, keepdim=True)
        history.keep_row(t, state, log_weights, parents, None)
    return genealogy(history.result(log_weights), 1).squeeze(1)


@torch.no_grad()
def move_blocks(bridge: Bridge, paths: Tensor, offset: int) -> Tensor:
    """Metropolis–Hastings moves of blocks of states between their neighbours, one after another.

    ``paths`` (M, T, D); blocks begin at rows ``offset``, ``offset`` + ℓ/2, …, and rows 0 and T − 1 stay.
    """
    paths = paths.clone()
    alone = paths.new_zeros(len(paths), 1)
    for t in range(offset, bridge.starts, max(1, bridge.block // 2)):
        stretch = paths[:, None, t : t + bridge.block + 2]
        paths[:, t : t + bridge.block + 1] = bridge.move(t, stretch[:, :, 0], alone, stretch).squeeze(1)
    return paths


def particle_gibbs(
    problem: Problem,
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

    Args:
        problem: model and observations.
        guide: "controlled" or "bootstrap".
        options: num_filters chains of num_draws draws each; num_particles of every sweep.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        executor: whose workers run the chains, ``options.filters_per_task`` at a time; the guide is fitted here.
        checkpoint: keeps the guide and the chains that are done, and goes on from there.
        warmup, thin: sweeps that are thrown away at first, and sweeps from one draw to the next.

    The attributes of sample_stats hold the largest R-hat and the smallest effective sample sizes of any torque, over
    all sweeps after the warm-up. Raises InputError for fewer than 2 particles, or a body that is uncertain; LostWork
    when chains cannot be had.
    """
    options = options or SMCOptions()
    if options.num_particles < 2:
        raise InputError(
            f"particle Gibbs needs at least 2 particles, the held one among them: got {options.num_particles}"
        )
    if problem.model.body.has_priors:
        raise InputError(
            "particle Gibbs takes the body as known, and this one is uncertain: drop its priors and [uncertainty], "
            "or use smc"
        )
    options.check()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    checkpoint = inside(checkpoint, f"particle-gibbs-{guide}")
    smoother = None
    if guide == "controlled":
        smoother = fitted_guide(problem, options, start, seed, inside(checkpoint, "guide"))
    sweeps, sizes = warmup + thin * options.num_draws, options.tasks()
    parts = spread(
        run_chains,
        [
            (
                model,
                observations,
                replace(options, num_filters=size),
                smoother,
                derived(seed, FILTERS, k),
                warmup,
                sweeps,
            )
            for k, size in enumerate(sizes)
        ],
        [f"chains {end - size} to {end - 1}" for size, end in zip(sizes, accumulate(sizes), strict=True)],
        executor=executor,
        checkpoint=checkpoint,
        steps=sweeps,
        progress=None if progress is None else lambda done, total: progress(done, total, "sweep"),
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
            diagnostics=mixing(model.net_torque(kept).numpy()),
        )


@torch.no_grad()
def run_chains(
    model: StateSpaceModel,
    observations: Tensor,
    options: SMCOptions,
    smoother: GaussianSmoother | None,
    seed: int,
    warmup: int,
    sweeps: int,
    progress: Callable[[int, int], None] | None = None,
) -> Tensors:
    """Chains from a seed of their own: what one worker does. Returns "paths" (M, S, T, D) after the warm-up."""
    model, rows = model.to(device=options.device), observations.to(options.device)
    guide, bridge = Bootstrap(model), None
    if smoother is not None:
        guide = Controlled(model, rows, smoother)
        if len(rows) > BLOCK + 2 and options.device == "cpu":
            bridge = Bridge(model, rows, smoother, BLOCK)
    sizes, kept = {"num_particles": options.num_particles, "threshold": options.ess_threshold}, []
    with seeded(seed, options.device):
        paths = first_paths(guide, rows, options.num_filters, **sizes)
        for number in range(sweeps):
            paths = sweep(guide, rows, paths, **sizes)
            if bridge is not None:
                paths = move_blocks(bridge, paths, number % (BLOCK // 2))
            if number >= warmup:
                kept.append(paths.cpu())
            if progress is not None:
                progress(number + 1, sweeps)
    return {"paths": torch.stack(kept, 1)}
