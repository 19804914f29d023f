"""A leg on a rail, torques and contact unknown: how well filters agree, and whether bands hold.

MuJoCo plays a leg (`tests/legs.py`) that drops, hops, stands or slips on ice. Keypoints at 100 Hz have 2 mm of noise.
Torques of hip and knee, and the force of the floor, are inferred by `infer_engine` with fitted scales. The table has,
over seeds: the standard deviation of log Ẑ over filters, the share of rows whose 90 % band holds the true torque, and
the true vertical force where it acts, the inferred impulse over the true one, errors, and CPU seconds. While the foot
stands, motion tells one combination of both torques: the share is also given along the row's narrowest direction of the
posterior, and along its widest, which the prior decides.

    python benchmarks/leg.py --seeds 20 --filters 4 [--kinds drop slip] [--results FILE]
"""

import argparse
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from kept import kept
from legs import KINDS, SITES, leg_recording

from invdyn.inference.infer_engine import infer_engine
from invdyn.models import Scene
from invdyn.recordings import Recording

ACTING = 1.0
"""N of true force from which on it acts."""
PATHS = 128
"""Drawn from all filters together: of 32, quantiles of .05 and .95 lie too far inside by a tenth of the share."""


def measured(kind: str, seed: int, rows: int, filters: int, particles: int) -> dict[str, float]:
    """Figures of one recording."""
    leg = leg_recording(kind, seed, rows=rows)
    seen = Recording(time=leg.time, keypoints=leg.rows.reshape(rows, -1, 2), keypoint_names=SITES, name=kind)
    begin = time.process_time()
    sizes = {"num_filters": filters, "num_particles": particles, "num_draws": -(-PATHS // filters)}
    idata = infer_engine(seen, Scene.of(leg.text, dimensions=2), seed=seed, **sizes)
    seconds = time.process_time() - begin
    posterior = idata["posterior"].stack(sample=("chain", "draw"), create_index=False)
    torque = posterior["torque"].sel(joint=["hip", "knee"]).transpose("sample", "time", "joint").values[:, :-1]
    force = np.zeros((len(torque), rows - 1))
    if "contact_force" in posterior:
        own = posterior["contact_force"].transpose("sample", "time", "contact", "axis").values[:, :-1]
        ground = [str(name).startswith("floor-") for name in posterior["contact"].values]
        force = own[:, :, ground, 2].sum(-1)
    true_torque, true_force = leg.torque[:-1], leg.ground_force[:-1, 2]
    acts = true_force > ACTING
    return {
        "filters": float(idata["sample_stats"]["log_evidence"].values.std(ddof=1)),
        "usable": float(idata["sample_stats"].attrs.get("usable", 0)),  # the linearised model's answer is not filters'
        "torque": float(held(torque, true_torque).mean()),
        "told": along(torque, true_torque, acts, 0),
        "untold": along(torque, true_torque, acts, -1),
        "force": float(held(force, true_force)[acts].mean()),
        "impulse": float(force.mean(0).sum() / true_force.sum()),
        "torque_error": rms(np.median(torque, 0) - true_torque),
        "torque_size": rms(true_torque),
        "force_error": rms(np.median(force, 0) - true_force),
        "force_size": rms(true_force),
        "seconds": seconds,
    }


def held(draws: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Whether 90 % bands of draws (N, …) hold the truth (…)."""
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    return (low <= truth) & (truth <= high)


def along(draws: np.ndarray, truth: np.ndarray, rows: np.ndarray, which: int) -> float:
    """Share of ``rows`` (T,) held along a principal axis, narrowest first, of draws (N, T, K) of the truth (T, K)."""
    off = draws - draws.mean(0)
    axis = np.linalg.eigh(np.einsum("ntk,ntl->tkl", off, off))[1][..., which]
    return float(held(np.einsum("ntk,tk->nt", draws, axis), np.einsum("tk,tk->t", truth, axis))[rows].mean())


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--filters", type=int, default=16)
    parser.add_argument("--particles", type=int, default=200)
    parser.add_argument("--results", type=Path, help="file that keeps each recording's figures")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    sizes = (arguments.rows, arguments.filters, arguments.particles)
    runs: dict[str, list[dict[str, float]]] = {kind: [] for kind in arguments.kinds}
    for seed in range(arguments.seeds):  # of every kind before the next seed, so that what is kept is a table
        for kind in arguments.kinds:
            runs[kind].append(kept(arguments.results, f"{kind} {seed} {sizes}", partial(measured, kind, seed, *sizes)))
    print(
        "| leg | sd of log Ẑ | usable | torque in band (told, untold) | force in band | impulse | torque rmse "
        "| force rmse | CPU s |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for kind, own in runs.items():
        mean = {name: float(np.mean([run[name] for run in own])) for name in own[0]}
        worst = max(run["filters"] for run in own)
        spread = np.abs([run["impulse"] - 1 for run in own]).max()
        print(
            f"| {kind} | {mean['filters']:.2f} (worst {worst:.2f}) | {mean['usable']:.0%} | {mean['torque']:.2f} "
            f"({mean['told']:.2f}, {mean['untold']:.2f}) | "
            f"{mean['force']:.2f} | {mean['impulse']:.3f} (off by {spread:.1%} at most) | "
            f"{mean['torque_error']:.2g} of {mean['torque_size']:.2g} N·m | "
            f"{mean['force_error']:.2g} of {mean['force_size']:.2g} N | {mean['seconds']:.0f} |"
        )


if __name__ == "__main__":
    main()
