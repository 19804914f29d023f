"""Joint torques of the DFKI robot from what a camera sees, against its own torque sensors.

Two settings, torque hidden: keypoints made from the encoders at 60 frames/s with 3 mm noise
(sys_id runs), and the pixels tracked in the film at 30 frames/s (t = 0–5 s). The truth is the
measured motor torque less the friction that the lab identified (model_2.0: b θ̇ + cf arctan(100 θ̇)),
averaged over each frame. Beside it, filter-and-differentiate: zero-phase Butterworth on the
inverse-kinematics angles, differentiated twice, inverse dynamics; its cut-off is the best in
hindsight for each joint and run.

    INVDYN_DATA=… python benchmarks/dfki_torque.py [--runs 00 02 05 film] [--seed 0]
"""

import argparse
import json
import time
from dataclasses import dataclass

import numpy as np
import torch
from scipy.signal import butter, filtfilt

from invdyn.inference import infer, pooled
from invdyn.models import Body, dynamics_for
from invdyn.recordings import Recording, Truth, keypoints_from_angles, load, load_truth

FRICTION = {"viscous": (0.001, 0.001), "coulomb": (0.093, 0.078)}  # model_2.0, N·m·s/rad and N·m
CUTOFFS = np.geomspace(1.0, 14.0, 40)  # Hz


@dataclass
class Case:
    name: str
    recording: Recording
    truth: Truth
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


def case(run: str, body: Body, seed: int = 0) -> Case:
    if run == "film":
        recording, truth = load("dfki-film"), load_truth("dfki-film")
        body = body.with_values(length=[0.3, 0.22])  # the tracked disc sits beyond the link's end
        torque = joint_torque(truth)
        return Case(run, recording, Truth(truth.time, truth.angle, truth.velocity, torque, truth.joint_names), body)
    log = load_truth(f"dfki-trajectory-{run}")
    lengths = [link.nominal("length") for link in body.links]
    recording = keypoints_from_angles(log, lengths, noise_sd=0.003, rate=60.0, seed=seed)
    at = recording.time
    torque = frame_means(at, log.time, joint_torque(log), 1 / 60)
    smooth = log.at(at)
    return Case(run, recording, Truth(at, smooth.angle, smooth.velocity, torque, log.joint_names), body)


def filter_and_differentiate(case: Case) -> np.ndarray:
    """Torques (C, T, K) for each cut-off, order-4 zero-phase Butterworth."""
    tips = case.recording.keypoints
    along = np.diff(np.concatenate([np.zeros_like(tips[:, :1]), tips], axis=1), axis=1)
    phi = np.unwrap(np.arctan2(along[..., 1], along[..., 0]), axis=0)
    angle = np.diff(phi, axis=1, prepend=0.0)
    dt = case.recording.frame_interval
    body, dynamics = case.body.parameters(), dynamics_for(case.body.num_joints)
    out = []
    for cutoff in CUTOFFS:
        q = filtfilt(*butter(2, cutoff, fs=1 / dt), angle, axis=0)
        qd = np.gradient(q, dt, axis=0)
        qdd = np.gradient(qd, dt, axis=0)
        out.append(dynamics.inverse(*(torch.as_tensor(a.copy()) for a in (q, qd, qdd)), body).numpy())
    return np.stack(out)


def rmse(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(error**2, axis=-2))


def score(case: Case, seed: int, **options) -> dict:
    start = time.perf_counter()
    idata = infer(case.recording, case.body, hide_torque=True, truth=case.truth, seed=seed, **options)
    seconds = time.perf_counter() - start
    draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values
    truth = case.truth.torque
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    mean = draws.mean(axis=0)
    classical = filter_and_differentiate(case)
    errors = rmse(classical - truth)
    best = errors.argmin(axis=0)
    return {
        "run": case.name,
        "rmse": rmse(mean - truth).tolist(),
        "correlation": [float(np.corrcoef(mean[:, k], truth[:, k])[0, 1]) for k in range(truth.shape[1])],
        "coverage_90": ((low <= truth) & (truth <= high)).mean(axis=0).tolist(),
        "baseline_rmse": errors.min(axis=0).tolist(),
        "baseline_cutoff_hz": CUTOFFS[best].tolist(),
        "outer_ess": idata.attrs["outer_ess"],
        "seconds": seconds,
        "settings": json.loads(idata.attrs["settings"]),
    }


def main() -> None:
    from importlib.resources import files

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", nargs="+", default=["00", "02", "05", "film"])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    body = Body.from_toml(files("invdyn.models") / "bodies" / "dfki_design_a0.toml")
    print(f"{'run':<6} {'rmse N·m':<14} {'best Butterworth':<18} {'correlation':<12} {'cover 90 %':<12} {'ESS':<5} s")
    for run in arguments.runs:
        row = score(case(run, body, arguments.seed), arguments.seed)

        def pair(name, row=row):
            return "/".join(f"{value:.3f}" for value in row[name])

        print(
            f"{run:<6} {pair('rmse'):<14} {pair('baseline_rmse'):<18} {pair('correlation'):<12} "
            f"{pair('coverage_90'):<12} {row['outer_ess']:<5.1f} {row['seconds']:.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
