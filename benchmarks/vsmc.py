"""Variational SMC: its bound on the published example, a gradient step's cost, and what it learns.

bound     The linear-Gaussian example of Naesseth et al. (2018): T 10, 5 states, 3 observed, α .42, r .1, numpy
          RandomState(0). The model is fixed, the affine guide is trained at N = 4; bound before and after, over
          20,000 filters, and the share of the bootstrap bound's gap to Kalman's log Z that training closes.
step      The paper's planar arm (200 rows, 16 × 100 particles, controlled guide with its correction, lengths and
          masses learned): seconds of one SVI step, the median of 5.
memory    The same arm, longer: peak memory of a process that makes the guide and one SVI step, with the whole graph
          and with 50 rows of it at a time; 20 rows give what imports alone need.
learn     The same arm: lengths from (1.20, .70) and masses from (.30, .40), truth (1, 1) and (.5, .3), 156 steps
          (4 × 50 particles), the guide made again at the parameters so far every four; next to it the maximum
          of the linearised evidence and its posterior sd, which is what this much data can tell.
coverage  The same arm and the same wrong start, by the method "vsmc" (50 steps; 128 filters of 50 particles, each with
          its own lengths and masses, prior e^(±2) round the start): on --sets simulated recordings of --frames rows,
          weighted medians, whether the 90 % intervals hold the truth, and how often they should.
scale     Three of these recordings with the torque's scale σ_τ learned too, which trades with the masses: what the
          posterior says about that.

    python benchmarks/vsmc.py [bound step memory learn coverage scale] [--seeds 4] [--sets 20] [--first 0]
                              [--frames 200]
"""

import argparse
import json
import multiprocessing
import resource
import time
from dataclasses import replace

import arviz as az
import numpy as np
import pyro
import torch
from planar_paper import paper_problem
from pyro.infer import SVI
from pyro.optim import Adam, ClippedAdam
from scipy.stats import binom

from invdyn.inference import Bootstrap, Free, ParticleFilter, Problem, SMCOptions, fit, gauss_newton, pooled
from invdyn.inference.methods.variational_smc import vsmc
from invdyn.inference.variational.affine import Affine, Corrected
from invdyn.inference.variational.vsmc import VSMC_ELBO
from invdyn.models import LinearGaussian, StateSpaceModel

LEARNED = ("body.length", "body.mass")
WRONG = {"body.length": (1.20, 0.70), "body.mass": (0.30, 0.40)}
STEPS, FRESH = 156, 4
"""Steps of learning, and after how many of them the guide is made again, for the parameters so far."""
RATE, SLOWER = 0.05, 0.1
"""Learning rate at first, of each new guide, and the factor by which that of the model falls over all steps."""


def published() -> tuple[LinearGaussian, torch.Tensor]:
    """Model and data of the published example."""
    numbers, dim, size, steps = np.random.RandomState(0), 5, 3, 10
    A = 0.42 ** (np.abs(np.subtract.outer(np.arange(dim), np.arange(dim))) + 1.0)
    C, R = np.eye(dim)[:size], 0.1 * np.eye(size)
    x, y = np.zeros(dim), []
    for _ in range(steps):
        x = numbers.multivariate_normal(A @ x, np.eye(dim))
        y.append(numbers.multivariate_normal(C @ x, R))
    moments = (A, np.eye(dim), C, R, np.zeros(dim), np.eye(dim))
    return LinearGaussian(*map(torch.as_tensor, moments), steps), torch.as_tensor(np.array(y))


def bound() -> None:
    model, y = published()
    exact = gauss_newton(model, y).log_evidence.item()

    def estimate(guide) -> float:
        run = ParticleFilter(model, guide, 4, num_filters=20_000).run(y, keep=0)
        return run.log_evidence.mean().item()

    blind, guide = estimate(Bootstrap(model)), Affine(model)
    print(f"\nlog Z {exact:.4f}; bound at N = 4, bootstrap {blind:.2f}\n")
    print("| steps | bound | gap closed | s |\n|---|---|---|---|")
    steps, start = 0, time.perf_counter()
    for rate, count in ((0.03, 300), (0.01, 300), (0.003, 400)):
        svi = SVI(model.sequence, guide, Adam({"lr": rate}), loss=VSMC_ELBO(4, 32))
        for _ in range(count):
            svi.step(y)
        steps += count
        seconds = time.perf_counter() - start
        with torch.no_grad():
            value = estimate(guide.sampled(model))
        print(f"| {steps} | {value:.3f} | {(value - blind) / (exact - blind):.2%} | {seconds:.1f} |", flush=True)


def arm_svi(problem: Problem, dtype: torch.dtype, **options) -> tuple[SVI, torch.Tensor]:
    model, y = problem.model.to(dtype=dtype), problem.observations.to(dtype)
    guide = Corrected(model, y, gauss_newton(problem.model, problem.observations))
    svi = SVI(model.learn(LEARNED).sequence, guide, Adam({"lr": 1e-3}), loss=VSMC_ELBO(100, 16, **options))
    return svi, y


def step() -> None:
    print("\n| dtype | rows of graph at once | wall s | CPU s |\n|---|---|---|---|")
    problem = paper_problem(0.01, 0)
    for dtype in (torch.float64, torch.float32):
        for chunk in (None, 50):
            pyro.clear_param_store()
            svi, y = arm_svi(problem, dtype, chunk=chunk)
            svi.step(y)
            wall, cpu = [], []
            for _ in range(5):
                start = time.perf_counter(), time.process_time()
                svi.step(y)
                wall.append(time.perf_counter() - start[0])
                cpu.append(time.process_time() - start[1])
            name, rows = str(dtype).removeprefix("torch."), chunk or "all"
            print(f"| {name} | {rows} | {np.median(wall):.2f} | {np.median(cpu):.2f} |", flush=True)


def _peak(rows: int, chunk: int | None) -> float:
    torch.set_num_threads(1)
    svi, y = arm_svi(paper_problem(0.01, 0, rows), torch.float64, chunk=chunk)
    svi.step(y)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memory() -> None:
    print("\n| rows | chunk | peak MiB |\n|---|---|---|")
    for rows, chunk in ((20, None), (200, None), (800, None), (200, 50), (800, 50), (3200, 50)):
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            print(f"| {rows} | {chunk or 'all'} | {pool.apply(_peak, (rows, chunk)):.0f} |", flush=True)


def train(model: StateSpaceModel, y: torch.Tensor) -> StateSpaceModel:
    """The model with the learned parameters that VSMC ends at."""
    pyro.clear_param_store()
    learned = model.learn(LEARNED)
    # A guide that learns more slowly than the model holds it where it was made: each begins with the first rate.
    optimiser = ClippedAdam({"lr": RATE, "lrd": SLOWER ** (1 / STEPS), "clip_norm": 100.0})
    for number in range(STEPS // FRESH):
        svi = SVI(learned.sequence, Corrected(model, y, name=f"guide {number}"), optimiser, loss=VSMC_ELBO(50, 4))
        for _ in range(FRESH):
            svi.step(y)
        model = model.replace(**{name: pyro.param(name).detach().clone() for name in LEARNED})
    return model


def tightest(model: StateSpaceModel, y: torch.Tensor) -> float:
    """Log-evidence at these parameters, by 64 filters of 100 particles with the controlled guide."""
    return VSMC_ELBO(100, 64).log_evidence(model, Corrected(model, y, name="evidence"), y).mean().item()


def learn(seeds: int) -> None:
    print("\n| seed | | L₁ | L₂ | M₁ | M₂ | bound | s |\n|---|---|---|---|---|---|---|---|")

    def row(seed: int, name: str, values: list[float], *rest: float) -> None:
        cells = [f"{x:.4f}" for x in values] + [f"{x:.1f}" for x in rest] + [""] * (2 - len(rest))
        print(f"| {seed} | {name} | " + " | ".join(cells) + " |", flush=True)

    def numbers(model: StateSpaceModel) -> list[float]:
        return torch.cat([model.parameters[name] for name in LEARNED]).tolist()

    for seed in range(seeds):
        problem = paper_problem(0.01, seed)
        wrong = {name: torch.tensor(value, dtype=torch.float64) for name, value in WRONG.items()}
        model, y = problem.model.replace(**wrong), problem.observations
        torch.manual_seed(seed)
        start = time.perf_counter()
        trained = train(model, y)
        seconds = time.perf_counter() - start
        start = time.perf_counter()
        best = fit(model, y, [Free(name) for name in LEARNED])
        other = time.perf_counter() - start
        with torch.no_grad():
            row(seed, "VSMC", numbers(trained), tightest(trained, y), seconds)
            row(seed, "linearised evidence", numbers(best.model), tightest(best.model, y), other)
            row(seed, "its relative posterior sd", [sd for name in LEARNED for sd in best.log_sd[name]])
            row(seed, "truth", numbers(problem.model), tightest(problem.model, y))


def wrongly_started(seed: int, frames: int) -> Problem:
    """A recording of the paper's arm, and its model with the wrong lengths and masses."""
    problem = paper_problem(0.01, seed, frames)
    wrong = {name: torch.tensor(value, dtype=torch.float64) for name, value in WRONG.items()}
    return replace(problem, model=problem.model.replace(**wrong))


def learned(problem: Problem, names: tuple[str, ...], seed: int) -> tuple[az.InferenceData, dict[str, np.ndarray]]:
    """Posterior by the method, and of each entry its weighted 5, 50 and 95 % quantiles."""
    idata = vsmc(
        problem, free=[Free(name) for name in names], options=SMCOptions(128, 50, 1), seed=1000 + seed, steps=50
    )
    quantiles = {}
    for name in names:
        values = pooled(idata)[name.removeprefix("body.")].values
        for k, column in enumerate(values.T):
            quantiles[f"{name}[{k}]"] = np.quantile(column, [0.05, 0.5, 0.95])
    return idata, quantiles


def coverage(first: int, sets: int, frames: int) -> None:
    truth = dict(zip([f"{n}[{k}]" for n in LEARNED for k in (0, 1)], (1.0, 1.0, 0.5, 0.3), strict=True))
    print(f"\n{frames} rows\n\n| set | | L₁ | L₂ | M₁ | M₂ | outer ESS | bound | gain | log Ẑ | s |")
    print("|---" * 11 + "|")
    hits, errors = {name: [] for name in truth}, {name: [] for name in truth}
    for seed in range(first, first + sets):
        start = time.process_time()
        idata, quantiles = learned(wrongly_started(seed, frames), LEARNED, seed)
        seconds = time.process_time() - start
        for name, (low, middle, high) in quantiles.items():
            hits[name].append(low <= truth[name] <= high)
            errors[name].append(abs(middle / truth[name] - 1))
        stats = idata["sample_stats"].attrs
        cells = [
            f"{m:.3f} [{low:.3f}, {high:.3f}]{'' if hits[n][-1] else ' ✗'}" for n, (low, m, high) in quantiles.items()
        ]
        cells += [f"{idata.attrs['outer_ess']:.0f}", f"{stats['vsmc_bound']:.2f}", f"{stats['vsmc_gain']:.2f}"]
        cells += [f"{idata.attrs['log_evidence']:.2f}", f"{seconds:.0f}"]
        print(f"| {seed} | | " + " | ".join(cells) + " |", flush=True)
    low, high = binom.ppf([0.025, 0.975], sets, 0.9)
    print(f"\n90 % intervals that hold the truth, of {sets} ({low:.0f} … {high:.0f} is what 95 % of exact ones give):")
    for name in truth:
        print(f"{name}: {sum(hits[name])}; error of the median: median {np.median(errors[name]):.1%}")


def scale(frames: int) -> None:
    for seed in range(3):
        idata, quantiles = learned(wrongly_started(seed, frames), (*LEARNED, "torque.scale"), seed)
        print(f"\nset {seed}, outer ESS {idata.attrs['outer_ess']:.0f} of 128")
        for name, (low, middle, high) in quantiles.items():
            print(f"{name}: {middle:.3f} [{low:.3f}, {high:.3f}]")
        print(json.dumps(json.loads(idata["sample_stats"].attrs["unidentified"]), ensure_ascii=False), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ("bound", "step", "memory", "learn", "coverage", "scale")
    parser.add_argument("parts", nargs="*", help=f"any of {', '.join(parts)}; all by default")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--sets", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed of the first set")
    parser.add_argument("--frames", type=int, default=200)
    arguments = parser.parse_args()
    unknown = set(arguments.parts) - set(parts)
    if unknown:
        parser.error(f"unknown part {', '.join(sorted(unknown))}; expected any of {', '.join(parts)}")
    torch.set_num_threads(1)
    for part in arguments.parts or parts:
        pyro.clear_param_store()
        torch.manual_seed(0)
        {
            "bound": bound,
            "step": step,
            "memory": memory,
            "learn": lambda: learn(arguments.seeds),
            "coverage": lambda: coverage(arguments.first, arguments.sets, arguments.frames),
            "scale": lambda: scale(arguments.frames),
        }[part]()


if __name__ == "__main__":
    main()
