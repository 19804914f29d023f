"""Simulation-based calibration of PMMH and SMC² on three models, and whether their evidence agrees.

Talts et al. (2018), as in calibration.py: θ* from the prior, states and observations from the model at θ*; the rank of
θ* among draws of the posterior is uniform. The ranks' statistic and its p-value are those of calibration.py, times
the number of quantities (Bonferroni). Quantities: each parameter, and the state of the middle row.

PMMH runs the chains of all simulations as one batch of filters, each simulation with its own adaptation; every 20th
draw counts. Its evidence is by importance sampling squared, Ẑ_IS, with a standard error for each simulation. Both
estimates are unbiased, so that the ratio Ẑ_SMC² / Ẑ_IS has mean one but for the error of Ẑ_IS, about its variance.

    python benchmarks/parameter_calibration.py              a table
    --simulations 200   --rows 25   --particles 50   --models linear,volatility,counts   --workers 2
"""

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import torch
from calibration import UniformBands, smallest, uniform_ranks
from parameter_models import MODELS
from torch import Tensor

from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.parameters.filter_bank import run_bank
from invdyn.inference.parameters.importance import importance_evidence
from invdyn.inference.parameters.pmmh import run_chains
from invdyn.inference.parameters.smc2 import smc2
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters

CHAINS, DRAWS, WARMUP, THIN = 4, 400, 300, 20
"""Of PMMH, for each simulation."""
PARAMETERS = 100
"""N_θ of SMC²."""
EVIDENCE_DRAWS = 500
SIMULATE, WALK, EVIDENCE, SMC2, RANK = range(5)
"""Places of the random numbers."""


def simulate(name: str, rows: int, count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Quantities (S, Q) of θ* and the states, and observations (S, T, O), at draws from the prior."""
    space = UnconstrainedParameters(MODELS[name](rows))
    with seeded(derived(seed, SIMULATE)):
        z = space.draw((count,))
        states, observations = space.at(z).simulate((count, 1))
    return quantities(space, z, states[:, 0]), observations[:, 0]


def quantities(space: UnconstrainedParameters, z: Tensor, paths: Tensor) -> Tensor:
    """(..., Q): parameters and the middle row's state, of z (..., P) and paths (..., T, D)."""
    values = [value.flatten(z.ndim - 1) for value in space.values(z).values()]
    return torch.cat([*values, paths[..., paths.shape[-2] // 2, :]], -1)


def names(name: str) -> list[str]:
    return [*UnconstrainedParameters(MODELS[name](2)).names, "middle state"]


def by_pmmh(
    name: str, observations: Tensor, particles: int, seed: int
) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray, np.ndarray, float]:
    """Draws (L, Q) and weights (L,) of each simulation, log-evidence and its sd (S,), and the mean acceptance."""
    space = UnconstrainedParameters(MODELS[name](observations.shape[1]))
    with seeded(derived(seed, WALK)):
        found = run_chains(
            space,
            observations,
            num_chains=CHAINS,
            num_draws=DRAWS,
            num_warmup=WARMUP,
            num_particles=particles,
        )
    kept = quantities(space, found.z, found.paths)[:, :, THIN - 1 :: THIN].flatten(1, 2).numpy()
    weights = np.full(kept.shape[1], 1 / kept.shape[1])

    evidence = []
    for number, (z, y) in enumerate(zip(found.z, observations, strict=True)):

        def log_likelihood(proposed: Tensor, y: Tensor = y) -> Tensor:
            return run_bank(space.at(proposed), y, len(proposed), particles).log_evidence

        with seeded(derived(seed, EVIDENCE, number)):
            evidence.append(importance_evidence(space, z.flatten(0, 1), log_likelihood, EVIDENCE_DRAWS))
    log_evidence, sd = np.array(evidence).T
    return [(draws, weights) for draws in kept], log_evidence, sd, found.acceptance.mean().item()


def by_smc2(
    name: str, particles: int, seed: int, job: tuple[int, Tensor]
) -> tuple[np.ndarray, np.ndarray, float, float, float]:
    """Draws (L, Q) and weights (L,) of one simulation, its log-evidence, acceptance, and seconds of CPU."""
    torch.set_num_threads(1)
    number, y = job
    start = time.process_time()
    model = MODELS[name](len(y))
    result = smc2(
        model,
        y,
        num_draws=PARAMETERS,
        num_particles=particles,
        num_runs=1,
        seed=derived(seed, SMC2, number),
    )
    values = [value[0].flatten(1) for value in result.draws.values()]
    draws = torch.cat([*values, result.paths[0, :, len(y) // 2]], -1).numpy()
    weights = result.log_weights[0].exp().numpy()
    seconds = time.process_time() - start
    return draws, weights / weights.sum(), result.log_evidence, result.acceptance.item(), seconds


def ranks(posteriors: list[tuple[np.ndarray, np.ndarray]], truth: Tensor, seed: int) -> np.ndarray:
    """u (Q, S) of draws and weights of each simulation, and truth (S, Q)."""
    rng = np.random.default_rng(derived(seed, RANK))
    pairs = zip(posteriors, truth.numpy(), strict=True)
    return np.array([uniform_ranks(draws, weights, true, rng) for (draws, weights), true in pairs]).T


def lines(name: str, rows: int, count: int, particles: int, seed: int, pool: ProcessPoolExecutor) -> list[str]:
    """Two rows of the table: PMMH's and SMC²'s."""
    truth, observations = simulate(name, rows, count, seed)
    start = time.process_time()
    walked, evidence, evidence_sd, acceptance = by_pmmh(name, observations, particles, seed)
    cells = {"PMMH": (walked, acceptance, time.process_time() - start)}

    jobs = list(enumerate(observations))
    found = list(pool.map(partial(by_smc2, name, particles, seed), jobs, chunksize=max(1, count // 8)))
    pairs = [(draws, weights) for draws, weights, *_ in found]
    rest = np.array([each[2:] for each in found])
    cells["SMC²"] = pairs, mean_of_finite(rest[:, 1]), rest[:, 2].sum()

    # Outer weights of the log-ratios: log of their mean, and its standard error.
    ratio = outer_weights(torch.as_tensor(rest[:, 0] - evidence))
    compared = {
        "PMMH": f"median sd {np.median(evidence_sd):.3f}",
        "SMC²": f"ratio {np.exp(ratio.log_evidence):.3f} ± {ratio.log_evidence_sd:.3f}, "
        f"sd of log {ratio.filter_sd:.3f}",
    }
    out = []
    for method, (posteriors, accepted, seconds) in cells.items():
        u = ranks(posteriors, truth, seed)
        each = UniformBands(count).p_value(u)
        central = np.abs(u[:-1] - 0.5)
        half, most = ((central < share / 2).mean() for share in (0.5, 0.9))
        oddest = names(name)[each.argmin()]
        p = smallest(each)
        row = [name, method, count, f"{p:.3f}", oddest, f"{half:.2f}", f"{most:.2f}", f"{accepted:.2f}"]
        out.append(f"| {' | '.join(map(str, [*row, compared[method], f'{seconds:.0f}']))} |")
    return out


def mean_of_finite(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", default=",".join(MODELS), help="comma-separated")
    parser.add_argument("--simulations", type=int, default=200)
    parser.add_argument("--rows", type=int, default=25)
    parser.add_argument("--particles", type=int, default=50, help="of each filter")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    header = "model,method,simulations,p,oddest quantity,50 % holds parameters,90 % holds parameters,acceptance,"
    header += "evidence,CPU s"
    print(f"| {' | '.join(header.split(','))} |")
    print(f"|{'---|' * len(header.split(','))}")
    with ProcessPoolExecutor(arguments.workers, get_context("spawn")) as pool:
        for name in arguments.models.split(","):
            sizes = arguments.rows, arguments.simulations, arguments.particles
            for line in lines(name, *sizes, arguments.seed, pool):
                print(line, flush=True)


if __name__ == "__main__":
    main()
