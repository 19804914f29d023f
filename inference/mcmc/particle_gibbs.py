"""Particle Gibbs with ancestor sampling: a Markov chain of whole paths, exact for any number of particles.

Lindsten, Jordan & Schön (2014), "Particle Gibbs with ancestor sampling", algorithm 2. One sweep runs a particle
filter in which the last particle is the path x' of the sweep before. Where that filter resamples, the past of that
particle is drawn again,

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

import torch
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.execution.progress import Report
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.bootstrap import Bootstrap
from invdyn.inference.filters.bridge import Bridge
from invdyn.inference.filters.defended import Defended, look_ahead
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.particles import History, take
from invdyn.inference.filters.proposal import Proposal
from invdyn.inference.filters.resampling import categorical, ess, resample
from invdyn.inference.filters.weights import log_step
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models import StateSpaceModel
from invdyn.models.observation.missing import observed_log_prob

BLOCK = 6
"""States that are moved together after a sweep."""


@torch.no_grad()
def sweep(
    guide: Proposal, observations: Tensor, reference: Tensor, num_particles: int, *, threshold: float = 0.5
) -> Tensor:
    """Paths (M, T, D) of the next sweep, given those of the sweep before.

    Args:
        guide: of a model whose transition has a density; its ``log_twist`` is used where it has one.
        observations: (T, O), NaN where missing.
        reference: (M, T, D) the sweep before.
        num_particles: N, the reference among them; at least 2.
        threshold: resample a filter when its ESS falls below this share of N; 1 is the printed algorithm.
    """
    return _conditional_filter(guide, observations, reference, len(reference), num_particles, threshold)


@torch.no_grad()
def first_paths(
    guide: Proposal, observations: Tensor, num_chains: int, num_particles: int, *, threshold: float = 0.5
) -> Tensor:
    """Paths (M, T, D) to begin at: lines of particle filters that hold none."""
    return _conditional_filter(guide, observations, None, num_chains, num_particles, threshold)


def _conditional_filter(
    guide: Proposal, observations: Tensor, reference: Tensor | None, chains: int, size: int, threshold: float
) -> Tensor:
    model, rows = guide.model, len(observations)
    device = observations.device
    history = History(rows, rows, chains, device)
    log_weights = torch.zeros(chains, size, dtype=torch.float64, device=device)
    itself = torch.arange(size, device=device).expand(chains, size)
    state, twist = torch.empty(0), torch.zeros_like(log_weights)  # no state before the first row
    for t in range(rows):
        parents = itself
        if t == 0:
            proposal, prior = guide.conditional_initial().expand(torch.Size((chains, size))), model.initial()
        else:
            need = ess(log_weights) < threshold * size
            if bool(need.any()):
                drawn = resample(log_weights, "multinomial")
                if reference is not None:
                    # Ancestors come sorted: a random one gives way to the reference's, not the largest.
                    out = torch.randint(size, (chains, 1), device=device)
                    drawn = drawn.scatter(-1, out, drawn[:, -1:])
                    reach = log_step(model, state, reference[:, t].unsqueeze(-2), observations[t], t)
                    drawn[:, -1] = categorical(log_weights - twist + reach)
                parents = torch.where(need.unsqueeze(-1), drawn, itself)
                state, twist = take(state, parents), twist.gather(-1, parents)
                log_weights = torch.where(need.unsqueeze(-1), 0.0, log_weights)
            proposal, prior = guide.conditional(t, state), model.transition(state, t)
        previous, state = state if t > 0 else None, proposal.sample()
        if reference is not None:
            state[:, -1] = reference[:, t]
        increment = prior.log_prob(state) - proposal.log_prob(state)
        if bool((~torch.isnan(observations[t])).any()):
            increment = increment + observed_log_prob(model.row_emission(previous, state, t), observations[t])
        if (ahead := guide.at(t, state).get("log_twist")) is not None:
            before, twist = twist, ahead
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


@torch.no_grad()
def run_chains(
    model: StateSpaceModel,
    observations: Tensor,
    options: SMCOptions,
    smoother: GaussianSmoother | None,
    seed: int,
    warmup: int,
    sweeps: int,
    guide: str = "controlled",
    progress: Report | None = None,
) -> Tensors:
    """Chains from a seed of their own: what one worker does. Returns "paths" (M, S, T, D) after the warm-up.

    Args:
        model: whose transition has a density; with a ``smoother`` Gaussian transition noise.
        observations: (T, O), NaN where missing.
        options: num_filters chains, num_particles of every sweep, ess_threshold, device.
        smoother: for a guide that looks ahead and moves of blocks; None for the bootstrap guide.
        seed: of every random number.
        warmup, sweeps: those thrown away at first, and all.
        guide: with a ``smoother``, "controlled" or "defended".
        progress: called with (sweeps done, sweeps).

    Raises ModelError where the transition has no density, as with a state without noise.
    """
    observations = check_model(model, observations, needs=("transition_density",))
    model, rows = model.to(device=options.device), observations.to(options.device)
    proposal: Proposal = Bootstrap(model)
    bridge: Bridge | None = None
    if smoother is not None:
        ahead = (Defended if guide == "defended" else look_ahead)(model, rows, smoother)
        proposal = ahead
        if len(rows) > BLOCK + 2 and options.device == "cpu" and ahead.one_gain:
            bridge = Bridge(model, rows, smoother, BLOCK)
    size, threshold, kept = options.num_particles, options.ess_threshold, []
    with seeded(seed, options.device):
        paths = first_paths(proposal, rows, options.num_filters, size, threshold=threshold)
        for number in range(sweeps):
            paths = sweep(proposal, rows, paths, size, threshold=threshold)
            if bridge is not None:
                paths = move_blocks(bridge, paths, number % (BLOCK // 2))
            if number >= warmup:
                kept.append(paths.cpu())
            if progress is not None:
                progress(number + 1, sweeps)
    return {"paths": torch.stack(kept, 1)}
