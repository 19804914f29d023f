"""Filters on a GPU and on the CPU of the same machine: the paper's arm in the plane and in space, and a leg that hops.

The controlled guide is fitted on the CPU in both cases and is not timed. Up to 1,000 particles a run keeps all rows,
for smoothing, and none beyond. log Ẑ is of the mean over all filters, with the sd of one of them: the same on both
devices but for Monte Carlo error. The leg's steps are MuJoCo's, by MuJoCo Warp on a GPU (extra `warp`); particles stay
on the CPU. `--devices cpu warp-cpu` compares Warp with MuJoCo there.

    python benchmarks/gpu.py [--particles 100 1000 10000] [--filters 64] [--threads 4] [--arms planar space leg]
"""

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np
import torch
from planar_paper import paper_problem
from spatial_paper import spatial_problem

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from legs import leg_file, leg_recording

from invdyn.inference import SMCOptions, run_filters
from invdyn.inference.filters.filtering import adapted_smoother
from invdyn.models import EngineModel, JointTorques, Scene, StateSpaceModel

ARMS = ("planar", "space", "leg")


def problem_of(arm: str, device: str, rows: int) -> tuple[StateSpaceModel, torch.Tensor]:
    """The model as it computes there, and what was observed."""
    if arm != "leg":
        problem = paper_problem(0.1, 0) if arm == "planar" else spatial_problem(0.003, 0)
        return problem.model, problem.observations
    warp = None if device == "cpu" else device.removeprefix("warp-")
    known = {"emission.keypoint_scale": 0.002, "initial.angle_scale": 1.0, "initial.velocity_scale": 0.1}
    scene, drive = Scene.of(leg_file("hop"), dimensions=2), JointTorques(("hip", "knee"))
    model = EngineModel(scene, np.arange(rows) * 0.01, drive=drive, parameters=known, warp=warp)
    return model, torch.as_tensor(leg_recording("hop", 0, rows=rows).rows)


def rows_of(arm: str, devices: list[str], particles: list[int], filters: int, rows: int) -> None:
    """Print one row for each number of particles."""
    smoother = adapted_smoother(*problem_of(arm, "cpu", rows), SMCOptions(filters, 100))
    for count in particles:
        cells = []
        for device in devices:
            model, observations = problem_of(arm, device, rows)
            options = SMCOptions(filters, count, 4, device="cpu" if arm == "leg" else device)
            keep = None if count <= 1000 else 0
            seconds = []
            for seed in range(1 if device == "cpu" else 2):  # the first run elsewhere loads its kernels
                torch.manual_seed(seed)
                start = time.perf_counter()
                result = run_filters(model, observations, options, smoother=smoother, keep=keep)
                evidence = result.log_evidence.cpu()  # waits for the device
                seconds.append(time.perf_counter() - start)
            speed = len(observations) * filters * count / min(seconds) / 1e6
            mean = torch.logsumexp(evidence, 0).item() - math.log(filters)
            cells += [f"{min(seconds):.2f}", f"{speed:.2g}", f"{mean:.2f} ± {evidence.std().item():.3f}"]
        print(f"| {arm} | {count} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--particles", type=int, nargs="+", default=[100, 1000, 10_000])
    parser.add_argument("--filters", type=int, default=64)
    parser.add_argument("--threads", type=int, default=4)
    parser.add_argument("--arms", nargs="+", choices=ARMS, default=ARMS)
    parser.add_argument("--devices", nargs=2, default=["cpu", "cuda"], help="of the leg also warp-cpu")
    parser.add_argument("--rows", type=int, default=60, help="of the leg")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    heads = [f"{device}: {what}" for device in given.devices for what in ("s", "M particle-steps/s", "log Ẑ")]
    print(f"| arm | N | {' | '.join(heads)} |\n{'|---' * (2 + len(heads))}|")
    for arm in given.arms:
        rows_of(arm, given.devices, given.particles, given.filters, given.rows)


if __name__ == "__main__":
    main()
