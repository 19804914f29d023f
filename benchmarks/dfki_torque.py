"""Joint torques of the DFKI robot from what a camera sees, against its own torque sensors.

Two settings, torque hidden: keypoints made from the encoders at 60 frames/s with 3 mm noise
(sys_id runs), and the pixels tracked in the film at 30 frames/s (t = 0–5 s).

Truth: the measured motor torque less the friction that the lab identified (model_2.0, b θ̇ + cf arctan(100 θ̇)),
averaged over each frame; "links" also takes off what turns the motors' own rotors (gear² I_r θ̈ and its
coupling, from the encoders at 500 Hz), as the body here has links and no rotors.

Next to it, filter-and-differentiate: zero-phase Butterworth (order 4) on the inverse-kinematics angles,
differentiated twice, inverse dynamics. Its cut-off is the best in hindsight, one for each run ("best
Butterworth") or even one for each joint ("per joint").

    INVDYN_DATA=… python benchmarks/dfki_torque.py [--runs 00 02 05 film] [--torque matern32] [--seed 0]
"""

import argparse
import time
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import torch
from scipy.signal import butter, filtfilt

from invdyn.inference import infer, pooled
from invdyn.inference.methods.differentiate import derivatives, inverse_dynamics, joint_angles
from invdyn.models import TORQUE_PROCESSES, Body, Keypoints, Observation
from invdyn.recordings import Recording, Truth, keypoints_from_angles, load, load_truth

FRICTION = {"viscous": (0.001, 0.001), "coulomb": (0.093, 0.078)}  # model_2.0, N·m·s/rad and N·m
ROTOR = 7.659297952841183e-05  # kg·m², behind a gear of 6
GEAR = 6.0
CUTOFFS = np.geomspace(1.0, 14.0, 40)  # Hz


@dataclass
class Case:
    name: str
    recording: Recording
    truth: Truth  # torque: motor less friction
    links: np.ndarray  # (T, K) N·m: less the rotors' inertia too
    body: Body


def joint_torque(truth: Truth) -> np.ndarray:
    """Motor torque less identified friction, (T, K) N·m."""
    viscous, coulomb = (np.array(FRICTION[k]) for k in ("viscous", "coulomb"))
    friction = viscous * truth.velocity + coulomb * np.arctan(100 * truth.velocity)
    return truth.torque - friction


def frame_means(times: np.ndarray, source: np.ndarray, values: np.ndarray, width: float) -> np.ndarray:
    """Mean of ``values`` (S, K) within ± width/2 of each time; robust to a fast, noisy log."""
    left = np.searchsorted(source, times - width / 2)
    right = np.maximum(np.searchsorted(source, times + width / 2), left + 1)
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    right = np.minimum(right, len(source))
    left = np.minimum(left, right - 1)
    return (total[right] - total[left]) / (right - left)[:, None]


def rotor_torque(log: Truth, times: np.ndarray) -> np.ndarray:
    """Torque (T, K) that turns the rotors, N·m, from the encoders: low-passed at 15 Hz, differentiated twice."""
    fine = np.arange(log.time[0], log.time[-1], 0.002)
    q = filtfilt(*butter(2, 15.0, fs=500.0), log.at(fine).angle, axis=0)
    qdd = np.gradient(np.gradient(q, 0.002, axis=0), 0.002, axis=0)
    inertia = ROTOR * np.array([[GEAR**2 + 1, -GEAR], [-GEAR, GEAR**2]])
    return np.stack([np.interp(times, fine, column) for column in (qdd @ inertia).T], axis=-1)


def case(run: str, body: Body, seed: int = 0) -> Case:
    if run == "film":
        recording, truth = load("dfki-film"), load_truth("dfki-film")
        log = load_truth("dfki-swing-up")
        body = body.with_values(length=[0.3, 0.22])  # the tracked disc sits beyond the link's end
        at, torque = recording.time, joint_torque(truth)
    else:
        log = load_truth(f"dfki-trajectory-{run}")
        lengths = [link.nominal("length") for link in body.links]
        recording = keypoints_from_angles(log, lengths, noise_sd=0.003, rate=60.0, seed=seed)
        at = recording.time
        truth, torque = log.at(at), frame_means(at, log.time, joint_torque(log), 1 / 60)
    truth = Truth(at, truth.angle, truth.velocity, torque, truth.joint_names)
    return Case(run, recording, truth, torque - rotor_torque(log, at), body)


def filter_and_differentiate(case: Case) -> np.ndarray:
    """Torques (C, T, K) for each cut-off, order-4 zero-phase Butterworth."""
    time, body = case.recording.time, case.body.parameters()
    tips = torch.as_tensor(case.recording.keypoints).flatten(-2)
    angle, _ = joint_angles(time, tips, Observation(Keypoints(range(case.body.num_joints))), body)
    return np.stack([inverse_dynamics(*derivatives(time, angle, cutoff), body) for cutoff in CUTOFFS])


def rmse(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(error**2, axis=-2))


def score(case: Case, torque: str, seed: int) -> list[dict]:
    start = time.perf_counter()
    process = TORQUE_PROCESSES[torque]()
    idata = infer(case.recording, case.body, torque=process, hide_torque=True, seed=seed)
    seconds = time.perf_counter() - start
    draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    mean = draws.mean(axis=0)
    classical = filter_and_differentiate(case)
    everything = slice(None)
    views = [("motor − friction", case.truth.torque, everything), ("links", case.links, everything)]
    if case.name == "film":
        # From 4.45 s on the controller chatters at ± 4 N·m, frame by frame: no camera at 30 frames/s shows that.
        calm = slice(int(np.searchsorted(case.recording.time, 4.45)))
        views.append(("motor − fr., <4.4 s", case.truth.torque, calm))
    rows = []
    for label, truth, part in views:
        truth, seen, classic = truth[part], mean[part], classical[:, part]
        covered = (low[part] <= truth) & (truth <= high[part])
        errors = rmse(classic - truth)
        one = errors.sum(axis=1).argmin()
        rows.append(
            {
                "run": case.name,
                "torque": torque,
                "truth": label,
                "rmse": rmse(seen - truth),
                "baseline": errors[one],
                "per_joint": errors.min(axis=0),
                "cutoff": CUTOFFS[one],
                "correlation": [np.corrcoef(seen[:, k], truth[:, k])[0, 1] for k in range(truth.shape[1])],
                "coverage": covered.mean(axis=0),
                "outer_ess": idata.attrs["outer_ess"],
                "seconds": seconds,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", nargs="+", default=["00", "02", "05", "film"])
    parser.add_argument("--torque", nargs="+", default=["ornstein_uhlenbeck", "matern32"])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    body = Body.from_toml(files("invdyn.models") / "bodies" / "dfki_design_a0.toml")
    heads = ("run", "torque process", "truth", "RMSE", "Butterworth", "… per joint", "correlation", "90 % covers")
    print(f"| {' | '.join(heads)} | outer ESS | s |\n{'|---' * (len(heads) + 2)}|")
    for run in arguments.runs:
        for torque in arguments.torque:
            for row in score(case(run, body, arguments.seed), torque, arguments.seed):
                cells = [" / ".join(f"{v:.3f}" for v in row[key]) for key in ("rmse", "baseline", "per_joint")]
                cells += [" / ".join(f"{v:.2f}" for v in row[key]) for key in ("correlation", "coverage")]
                cells += [f"{row['outer_ess']:.1f}", f"{row['seconds']:.0f}"]
                print(f"| {run} | {torque} | {row['truth']} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
