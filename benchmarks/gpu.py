"""Filters on a GPU and on the CPU of the same machine: the paper's arm in the plane and in space.

The controlled guide is fitted on the CPU in both cases and is not timed. Up to 1,000 particles a run keeps all rows,
for smoothing, and none beyond. log Ẑ is of the mean over 64 filters, with the sd of one of them: the same on both
devices but for Monte Carlo error.

    python benchmarks/gpu.py [--particles 100 1000 10000] [--filters 64] [--threads 4]
"""

import argparse
import math
import time

import torch
from planar_paper import paper_problem
from spatial_paper import spatial_problem

from invdyn.inference import Problem, SMCOptions, run_filters
from invdyn.inference.filters.filtering import adapted_smoother


def rows_of(name: str, problem: Problem, particles: list[int], filters: int) -> None:
    """Print one row for each number of particles."""
    smoother = adapted_smoother(problem.model, problem.observations, SMCOptions(filters, 100))
    for count in particles:
        cells = []
        for device in ("cpu", "cuda"):
            options = SMCOptions(filters, count, 4, device=device)
            keep = None if count <= 1000 else 0
            seconds = []
            for seed in range(1 if device == "cpu" else 2):  # the first run on a GPU loads its kernels
                torch.manual_seed(seed)
                start = time.perf_counter()
                result = run_filters(problem.model, problem.observations, options, smoother=smoother, keep=keep)
                evidence = result.log_evidence.cpu()  # waits for the device
                seconds.append(time.perf_counter() - start)
            speed = len(problem.observations) * filters * count / min(seconds) / 1e6
            mean = torch.logsumexp(evidence, 0).item() - math.log(filters)
            cells += [f"{min(seconds):.2f}", f"{speed:.1f}", f"{mean:.2f} ± {evidence.std().item():.3f}"]
        print(f"| {name} | {count} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--filters", type=int, default=64)
    parser.add_argument("--threads", type=int, default=4)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    heads = [f"{device}: {what}" for device in ("CPU", "GPU") for what in ("s", "M particle-steps/s", "log Ẑ")]
    print(f"| arm | N | {' | '.join(heads)} |\n{'|---' * (2 + len(heads))}|")
    rows_of("planar", paper_problem(0.1, 0), given.particles, given.filters)
    rows_of("in space", spatial_problem(0.003, 0), given.particles, given.filters)


if __name__ == "__main__":
    main()
