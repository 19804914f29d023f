"""Joint torques of real arms against sensors that the filter has not seen, or against what physics says.

For each recording of `sensor_cases.py`, with every torque hidden, default options and the method `laplace`: rms error
of the posterior mean and share of true values in the 90 % band, joint by joint, half the band's mean width, the mean
interval score of the band (l, u), which a wider band must pay for (T. Gneiting and A. Raftery, JASA 102, 2007),

    (u − l) + 20 max(l − τ, 0) + 20 max(τ − u, 0),

how far the largest torque is off, and beside them filter-and-differentiate: a Butterworth filter forth and back,
differences, inverse dynamics, whose cut-off is the best in hindsight for each joint, as no one could know it.

    INVDYN_DATA=… python benchmarks/against_sensors.py ["kuka 1" "film" …] [--torque matern32] [--results FILE]
"""

import argparse
import resource
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
from kept import kept
from sensor_cases import NAMES, Case, made

from invdyn.inference import infer, pooled
from invdyn.inference.methods.differentiate import derivatives, inverse_dynamics, joint_angles, tree_angles
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import TORQUE_PROCESSES, dynamics_for

CUTOFFS = np.geomspace(0.3, 14.0, 40)  # Hz


def angles_of(case: Case) -> np.ndarray:
    """Coordinates (T, K) by inverse kinematics row by row, or the encoders' own."""
    problem = arm_problem(case.recording, case.body, **case.options)
    model, rows = problem.model, problem.observations
    if case.body.is_chain:
        return joint_angles(case.recording.time, rows, model.observation, model.body_parameters())[0]
    return tree_angles(model, case.body, rows)[0]


def filter_and_differentiate(case: Case) -> np.ndarray:
    """Torques (C, T, K) for each cut-off below half the row rate."""
    time, angle, body = case.recording.time, angles_of(case), case.body
    highest = 0.45 / np.median(np.diff(time))
    paths = (derivatives(time, angle, cutoff) for cutoff in CUTOFFS if cutoff < highest)
    return np.stack([inverse_dynamics(dynamics_for(body), *path, body.parameters()) for path in paths])


def rms(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(error**2, axis=-2))


def score(name: str, torque: str | None, method: str, seed: int) -> dict:
    case = made(name)
    began = time.process_time()
    process = None if torque is None else TORQUE_PROCESSES[torque]()
    sizes = {"num_filters": 16, "num_draws": 32} if method == "laplace" else {}
    idata = infer(case.recording, case.body, method=method, torque=process, seed=seed, **sizes, **case.options)
    took = time.process_time() - began
    draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values[:, case.counted]
    truth, mean = case.torque[case.counted], draws.mean(0)
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    classical = filter_and_differentiate(case)[:, case.counted]
    peak = np.abs(truth).max(0)
    with np.errstate(divide="ignore", invalid="ignore"):
        off = 100 * (np.abs(np.median(draws, 0)).max(0) / peak - 1)
    return {
        "rows": len(truth),
        "true rms": rms(truth).tolist(),
        "error": rms(mean - truth).tolist(),
        "hindsight": rms(classical - truth).min(0).tolist(),
        "covers": ((low <= truth) & (truth <= high)).mean(0).tolist(),
        "half width": ((high - low) / 2).mean(0).tolist(),
        "score": (high - low + 20 * (np.maximum(low - truth, 0) + np.maximum(truth - high, 0))).mean(0).tolist(),
        "peak": off.tolist(),
        "seconds": took,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


HEADS = (
    "recording|rows|rms of true torque|error, rms|best Butterworth|90 % covers|half width|interval score|peak off, %"
    "|CPU s"
)


def line(name: str, row: dict) -> str:
    digits = {"true rms": 2, "error": 2, "hindsight": 2, "covers": 2, "half width": 2, "score": 2, "peak": 0}
    cells = [" / ".join(f"{v:.{n}f}" if np.isfinite(v) else "–" for v in row[key]) for key, n in digits.items()]
    return f"| {name} | {row['rows']} | {' | '.join(cells)} | {row['seconds']:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=NAMES)
    parser.add_argument("--torque", choices=sorted(TORQUE_PROCESSES))
    parser.add_argument("--method", default="laplace")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path)
    arguments = parser.parse_args()
    warnings.filterwarnings("ignore", category=UserWarning)
    heads = HEADS.split("|")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name in arguments.names:
        make = partial(score, name, arguments.torque, arguments.method, arguments.seed)
        case = f"{name} {arguments.torque} {arguments.method} {arguments.seed}"
        print(line(name, kept(arguments.results, case, make)), flush=True)


if __name__ == "__main__":
    main()
