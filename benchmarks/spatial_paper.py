"""The simulated arm in space of Biderman et al. (2020): a healthy sampler, right intervals, and what the data tell.

Setting, as the paper's code has it (github.com/danbider/aesmc, test/run-3d-arm.ipynb): shoulder and elbow with yaw and
pitch, links of 1 m, .5 and .3 kg, gravity 1, step .01 s, 200 rows, OU torque with σ_τ 2 in the printed scaling and λ 2,
ε 4e-5, keypoint variance .01, all parameters known. Angles and velocities start from N(0, .001). Torques start from
their stationary law (sd .10 N·m); in the code they begin at sd .03. Beside it keypoints of sd .01 and .003.

For each seed: 64 filters of 100 particles, 8 smoothed trajectories of each. Outer ESS of the 64 filters; the sd over
them of log Ẑ; the share of true torques, angles and velocities inside the smoothed 90 % intervals; the rms error of
the smoothed mean torque; the share of the torque's prior sd that the data remove, 1 − (posterior sd) / (prior sd); and
seconds of CPU on one thread, from the known parameters to the smoothed posterior. Angles are compared as they are: the
known start says which of their aliases is meant. The last table is the paper's planar arm, at its own settings.

    python benchmarks/spatial_paper.py [--seeds 20] [--noise .1 .01 .003]
"""

import argparse
import time
from importlib.resources import files

import numpy as np
import torch
from planar_paper import paper_problem

from invdyn.inference import Problem, SMCOptions, pooled
from invdyn.inference.methods.registry import smc
from invdyn.models import load_body as load
from invdyn.models.divergence import Diverged
from invdyn.simulate import paper_arm, record

SIZES = SMCOptions(num_filters=64, num_particles=100, num_draws=8)
PLANAR = "planar"


def spatial_problem(noise: float, seed: int, num_frames: int = 200) -> Problem:
    """One simulated recording of the arm in space, keypoints off by a sd of ``noise``, with model and truth."""
    model = paper_arm(load(files("invdyn.models") / "bodies" / "paper_spatial_arm.toml"), num_frames)
    scale = model.parameters["emission.keypoint_scale"]
    model = model.replace(**{"emission.keypoint_scale": torch.full_like(scale, noise)})
    recording, truth = record(model, seed)
    return Problem(model, torch.as_tensor(recording.keypoints.reshape(num_frames, -1)), recording, truth)


def score(problem: Problem, seed: int) -> dict[str, float]:
    start = time.process_time()
    idata = smc(problem, options=SIZES, seed=seed)
    seconds = time.process_time() - start
    draws = {name: pooled(idata)[name].transpose("sample", "time", "joint").values for name in QUANTITIES}
    truth, torque = problem.truth, draws["torque"]
    covers = {}
    for name in QUANTITIES:
        low, high = np.quantile(draws[name], [0.05, 0.95], axis=0)
        true = getattr(truth, name)
        covers[f"90 % covers {name}"] = float(((low <= true) & (true <= high)).mean())
    prior = problem.model.torque.stationary(problem.model.dt[1:2], problem.model.parameters).mean().item()
    return {
        "outer ESS": idata.attrs["outer_ess"],
        "sd of log Ẑ": idata.attrs["log_evidence_spread"],
        **covers,
        "rms of true torque": float(np.sqrt((truth.torque**2).mean())),
        "rms error of torque": float(np.sqrt(((torque.mean(0) - truth.torque) ** 2).mean())),
        "prior sd removed": 1 - float(np.sqrt(torque.var(0).mean())) / prior,
        "CPU s": seconds,
    }


QUANTITIES = ("torque", "angle", "velocity")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.1, 0.01, 0.003])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for noise in [*arguments.noise, PLANAR]:
        rows, diverged = [], []
        for seed in range(arguments.seeds):
            try:
                problem = paper_problem(0.01, seed) if noise == PLANAR else spatial_problem(noise, seed)
                rows.append(score(problem, seed))
            except Diverged:
                diverged.append(seed)
        title = "planar arm, keypoints off by .22 m" if noise == PLANAR else f"keypoints off by {noise:g} m"
        print(f"\n| {title}, {len(rows)} seeds | min | median | mean | max |\n|---|---|---|---|---|")
        for name in rows[0]:
            values = np.array([row[name] for row in rows])
            cells = (values.min(), np.median(values), values.mean(), values.max())
            print(f"| {name} | " + " | ".join(f"{cell:.3g}" for cell in cells) + " |", flush=True)
        print(f"\nlowest outer ESS: seed {int(np.argmin([row['outer ESS'] for row in rows]))}", flush=True)
        if diverged:
            print(f"simulations that ran away: seeds {diverged}", flush=True)


if __name__ == "__main__":
    main()
