"""The simulated planar arm of Biderman et al. (2020): is the sampler healthy, are its intervals right?

Setting: step .03 s, 200 rows, OU torque with σ_τ 20 in the printed scaling and λ 6, keypoint variance .05,
links of 1 m, .5 and .3 kg, gravity 1, all parameters known. Angles and velocities start from N(0, 1),
torques from their stationary law, whose sd is 1.05 N·m. The noise ε of angles and velocities is read as a
standard deviation of .01 and of .1 per step.

For each seed: 64 filters of 100 particles with the controlled guide, 8 smoothed trajectories of each;
next to it 64 bootstrap filters of 1,000 particles. Outer ESS of the 64 filters; the sd over them of log Ẑ;
the share of the 2 × 200 true torques that lie inside the smoothed 90 % intervals; seconds of CPU on
one thread, from the known parameters to the smoothed posterior.

    python benchmarks/planar_paper.py [--seeds 20] [--epsilon .01 .1]
"""

import argparse
import time
from importlib.resources import files

import numpy as np
import torch

from invdyn.inference import Problem, SMCOptions, outer_weights, pooled, run_filters
from invdyn.inference.methods.registry import smc
from invdyn.models import Body
from invdyn.simulate import paper_arm, record

CONTROLLED = SMCOptions(num_filters=64, num_particles=100, num_draws=8)
BOOTSTRAP = SMCOptions(num_filters=64, num_particles=1000)


def paper_problem(epsilon: float, seed: int, num_frames: int = 200) -> Problem:
    """One simulated recording of the paper's arm, with its model and its truth."""
    body = Body.from_toml(files("invdyn.models") / "bodies" / "paper_planar_arm.toml")
    model = paper_arm(body, num_frames)
    ones = {"initial.angle_scale": 1.0, "initial.velocity_scale": 1.0}
    slack = {"noise.angle": epsilon, "noise.velocity": epsilon}
    parameters = {name: model.parameters[name].new_full((2,), value) for name, value in (ones | slack).items()}
    model = model.replace(**parameters)
    recording, truth = record(model, seed)
    return Problem(model, torch.as_tensor(recording.keypoints.reshape(num_frames, -1)), recording, truth)


def score(problem: Problem, seed: int) -> dict[str, float]:
    start = time.process_time()
    idata = smc(problem, options=CONTROLLED, seed=seed)
    seconds = time.process_time() - start
    draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    truth = problem.truth.torque
    start = time.process_time()
    blind = run_filters(problem.model, problem.observations, BOOTSTRAP, guide="bootstrap", keep=0)
    blind = outer_weights(blind.log_evidence)
    return {
        "outer ESS": idata.attrs["outer_ess"],
        "sd of log Ẑ": idata.attrs["log_evidence_spread"],
        "90 % covers": float(((low <= truth) & (truth <= high)).mean()),
        "CPU s": seconds,
        "bootstrap: outer ESS": blind.ess,
        "bootstrap: sd of log Ẑ": blind.filter_sd,
        "bootstrap: log Ẑ below": idata.attrs["log_evidence"] - blind.log_evidence,
        "bootstrap: CPU s": time.process_time() - start,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--epsilon", type=float, nargs="+", default=[0.01, 0.1])
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    found = {
        epsilon: [score(paper_problem(epsilon, seed), seed) for seed in range(arguments.seeds)]
        for epsilon in arguments.epsilon
    }
    heads = [f"ε {epsilon:g}: {what}" for epsilon in found for what in ("median", "mean", "least to most")]
    print(f"| {arguments.seeds} seeds | {' | '.join(heads)} |\n{'|---' * (len(heads) + 1)}|")
    for name in found[arguments.epsilon[0]][0]:
        cells = []
        for rows in found.values():
            values = np.array([row[name] for row in rows])
            cells += [f"{np.median(values):.3g}", f"{values.mean():.3g}", f"{values.min():.3g} to {values.max():.3g}"]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
