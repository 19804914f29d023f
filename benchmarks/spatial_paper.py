"""The simulated arm in space of Biderman et al. (2020): a healthy sampler, right intervals, and what the data tell.

Setting, as the paper's code has it (github.com/danbider/aesmc, test/run-3d-arm.ipynb): shoulder and elbow with yaw and
pitch, links of 1 m, .5 and .3 kg, gravity 1, step .01 s, 200 rows, OU torque with σ_τ 2 in the printed scaling and λ 2,
ε 4e-5, keypoint variance .01, all parameters known. Angles and velocities start from N(0, .001). Torques start from
their stationary law (sd .10 N·m); in the code they begin at sd .03. With it keypoints of sd .01 and .003.

For each seed: 64 filters of 100 particles, 8 smoothed trajectories of each. Outer ESS of the 64 filters; the sd over
them of log Ẑ; the share of true torques, angles and velocities inside the smoothed 90 % intervals; the rms error of
the smoothed mean torque; the share of the torque's prior sd that the data remove, 1 − (posterior sd) / (prior sd); and
seconds of CPU on one thread, from the known parameters to the smoothed posterior. Angles are compared as they are: the
known start says which of their aliases is meant. The last table is the paper's planar arm, at its own settings.

*The file's axes* are those that the truth was drawn in: the model is right, and near the pole of an elbow's angles its
posterior has heavy tails. *Axes from the data* are what `infer` takes where no start is given (`arm_problem`): a
joint whose motion comes to a pitch of 60° is rotated. The prior is then of torques about other axes than the truth's,
and the start is read off the first row; results are given in the file's axes for both.

    python benchmarks/spatial_paper.py [--seeds 20] [--noise .1 .01 .003] [--turned .1] [--no-planar] [--results FILE]
"""

import argparse
import time
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from kept import kept
from planar_paper import paper_problem
from scipy.spatial.transform import Rotation

from invdyn.inference import Problem, SMCOptions, arm_problem, pooled
from invdyn.inference.methods.registry import smc
from invdyn.models import Body, dynamics_for
from invdyn.models import load_body as load
from invdyn.models.divergence import Diverged
from invdyn.simulate import PAPER_IN_SPACE, paper_arm, record

SIZES = SMCOptions(num_filters=64, num_particles=100, num_draws=8)
QUANTITIES = ("angle", "velocity", "torque")


def spatial_problem(noise: float, seed: int, num_frames: int = 200) -> Problem:
    """One simulated recording of the arm in space, keypoints off by a sd of ``noise``, with model and truth."""
    model = paper_arm(load(files("invdyn.models") / "bodies" / "paper_spatial_arm.toml"), num_frames)
    scale = model.parameters["emission.keypoint_scale"]
    model = model.replace(**{"emission.keypoint_scale": torch.full_like(scale, noise)})
    recording, truth = record(model, seed)
    return Problem(model, torch.as_tensor(recording.keypoints.reshape(num_frames, -1)), recording, truth)


def turned_problem(filed: Problem, noise: float) -> Problem:
    """The same recording as `infer` binds it, noise and torque process known, in axes from the data."""
    known = {name: value for name, value in PAPER_IN_SPACE["settings"].items() if not name.startswith("initial.")}
    known |= {"emission.keypoint_scale": noise}
    rest = {name: PAPER_IN_SPACE[name] for name in ("torque", "integrator")}
    bound = arm_problem(filed.recording, filed.model.body, parameters=known, **rest)
    return replace(bound, truth=filed.truth)


def in_axes_of(filed: Body, rotated: Body, draws: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Angles, velocities and torques (..., K) of a tree of two sticks, given in the axes of another of the same links.

    Directions give angles. Sites move equally, J q̇ = J' q̇', so that velocities map by M = J'⁺ J, and torques, whose
    work is the same, by its transposed inverse.
    """
    if rotated == filed:
        return draws
    ours, theirs = dynamics_for(rotated), dynamics_for(filed)
    q, qd, torque = (torch.as_tensor(draws[name]) for name in QUANTITIES)
    tips = ours.keypoints(q, rotated.parameters()).numpy()
    reported, placed = np.empty_like(draws["angle"]), np.eye(3)
    for place, link in enumerate(filed.links):
        ahead = tips[..., place, :] - (tips[..., place - 1, :] if place else 0.0)
        placed = placed @ np.array(link.rotation)
        x, y, z = np.moveaxis((ahead[..., None, :] @ placed)[..., 0, :] / link.length, -1, 0)
        reported[..., 2 * place], reported[..., 2 * place + 1] = np.arctan2(y, x), -np.arcsin(z.clip(-1, 1))
        turns = Rotation.from_euler("ZY", reported[..., 2 * place : 2 * place + 2].reshape(-1, 2)).as_matrix()
        placed = placed @ turns.reshape(*reported.shape[:-1], 3, 3)
    before = ours.jacobian(q, rotated.parameters()).flatten(-3, -2)
    after = theirs.jacobian(torch.as_tensor(reported), filed.parameters()).flatten(-3, -2)
    there = torch.linalg.pinv(after) @ before
    back = torch.linalg.pinv(before) @ after
    moved = ((there @ qd[..., None])[..., 0], (back.mT @ torque[..., None])[..., 0])
    return dict(zip(QUANTITIES, (reported, *(each.numpy() for each in moved)), strict=True))


def score(problem: Problem, filed: Body | None, seed: int) -> dict[str, float]:
    """One row of a table; ``filed`` is the tree in whose axes the truth is given, None where it is the problem's."""
    start = time.process_time()
    idata = smc(problem, options=SIZES, seed=seed)
    seconds = time.process_time() - start
    draws = {name: pooled(idata)[name].transpose("sample", "time", "joint").values for name in QUANTITIES}
    removed = np.sqrt(draws["torque"].var(0).mean())
    if filed is not None:
        draws = in_axes_of(filed, problem.model.body, draws)
    truth, covers = problem.truth, {}
    for name in ("torque", "angle", "velocity"):
        low, high = np.quantile(draws[name], [0.05, 0.95], axis=0)
        true = getattr(truth, name)
        covers[f"90 % covers {name}"] = float(((low <= true) & (true <= high)).mean())
    prior = problem.model.torque.stationary(problem.model.dt[1:2], problem.model.parameters).mean().item()
    return {
        "outer ESS": idata.attrs["outer_ess"],
        "sd of log Ẑ": idata.attrs["log_evidence_spread"],
        **covers,
        "rms of true torque": float(np.sqrt((truth.torque**2).mean())),
        "rms error of torque": float(np.sqrt(((draws["torque"].mean(0) - truth.torque) ** 2).mean())),
        "prior sd removed": 1 - float(removed) / prior,
        "CPU s": seconds,
    }


def run(kind: str, noise: float, seed: int) -> dict[str, float]:
    """A row, empty where the simulation ran away."""
    try:
        if kind == "planar":
            return score(paper_problem(0.01, seed), None, seed)
        filed = spatial_problem(noise, seed)
        if kind == "filed":
            return score(filed, None, seed)
        rotated = turned_problem(filed, noise)
        joints = {"joints turned": float(len(rotated.notes))}
        return joints | score(rotated, filed.model.body, seed)
    except Diverged:
        return {}


TITLES = {
    "filed": "keypoints off by {:g} m",
    "turned": "keypoints off by {:g} m, axes from the data",
    "planar": "planar arm, keypoints off by {:.2g} m",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--noise", type=float, nargs="*", default=[0.1, 0.01, 0.003])
    parser.add_argument("--turned", type=float, nargs="*", default=[0.1], help="noise, m, with axes from the data")
    parser.add_argument("--planar", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rotated = [("turned", noise) for noise in arguments.turned]
    filed = [("filed", noise) for noise in arguments.noise]
    planar = [("planar", 0.05**0.5)] if arguments.planar else []
    for kind, noise in [*filed[:1], *rotated, *filed[1:], *planar]:
        rows = {}
        for seed in range(arguments.seeds):
            rows[seed] = kept(arguments.results, f"{kind} {noise:g} {seed}", lambda: run(kind, noise, seed))  # noqa: B023
        done = {seed: row for seed, row in rows.items() if row}
        title = TITLES[kind].format(noise)
        print(f"\n| {title}, {len(done)} seeds | min | median | mean | max |\n|---|---|---|---|---|")
        for name in next(iter(done.values())):
            values = np.array([row[name] for row in done.values()])
            cells = (values.min(), np.median(values), values.mean(), values.max())
            print(f"| {name} | " + " | ".join(f"{cell:.3g}" for cell in cells) + " |", flush=True)
        print(f"\nlowest outer ESS: seed {min(done, key=lambda seed: done[seed]['outer ESS'])}", flush=True)
        if ran := sorted(rows.keys() - done.keys()):
            print(f"simulations that ran away: seeds {ran}", flush=True)


if __name__ == "__main__":
    main()
