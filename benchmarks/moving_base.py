"""Torques of an arm whose base is carried about: still, walking, running, jumping, in a bus; and falling freely.

MuJoCo plays the arm, of two links in the plane or four coordinates in space: its base stands on slides whose motion is
given, and its inverse dynamics says the torques. Base and joints are seen 60 times a second for 3 s with an error of
3 mm. `infer` gets them as it would a person's, at its defaults. The table has, over seeds and joints, the rms of
the torque, that of the median's error, the share of rows whose 90 % band holds the truth, and whether the base was
taken to move. "at rest" is the same call with every keypoint taken relative to the base's track, row by row, as of a
base that stands still.

    python benchmarks/moving_base.py [--seeds 6] [--method smc] [--results FILE] [--cases walking/2 …]
"""

import argparse
import json
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from invdyn.inference import infer, pooled
from invdyn.recordings import Recording, Truth

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from carried import Carried, person

RATE, SECONDS, NOISE = 60, 3.0, 0.003


def still(t, rng):
    """Nothing."""
    return np.zeros((len(t), 3))


def walking(t, rng):
    """Steps of 1.8 to 2.2 Hz: 2 to 4 cm up and down, forwards with a swing of the speed, sideways at half the pace."""
    w, phase = 2 * np.pi * rng.uniform(1.8, 2.2), rng.uniform(0, 2 * np.pi)
    up = rng.uniform(0.01, 0.02) * np.cos(w * t + phase) + 0.003 * np.cos(2 * w * t)
    along = rng.uniform(1.0, 1.5) * t + 0.015 * np.sin(w * t + phase + 0.5)
    return np.stack([along, up, 0.02 * np.sin(w * t / 2)], -1)


def running(t, rng):
    """2.8 Hz, 8 cm up and down, 3 m/s."""
    w = 2 * np.pi * rng.uniform(2.6, 3.0)
    up = 0.04 * np.cos(w * t) + 0.006 * np.cos(2 * w * t + 1)
    return np.stack([3.0 * t + 0.02 * np.sin(w * t + 0.5), up, 0.015 * np.sin(w * t / 2)], -1)


def jumping(t, rng):
    """Crouch, push, flight under gravity, landing: accelerations, integrated twice."""
    start, height = rng.uniform(0.5, 0.8), rng.uniform(0.15, 0.3)
    fine = np.arange(0, t[-1] + 1e-3, 1e-3)
    g, v = 9.81, np.sqrt(2 * 9.81 * height)

    def pulse(begin, last, size):
        s = (fine - begin) / last
        return np.where((s > 0) & (s < 1), size * np.sin(np.pi * s.clip(0, 1)) ** 2, 0.0)

    down, push, air, land = 0.35, 0.3, 2 * v / g, 0.25
    acceleration = pulse(start, down / 2, -4.0) + pulse(start + down / 2, down / 2, 4.0)
    begin = start + down
    acceleration += pulse(begin, push, 2 * v / push)
    leave = begin + push
    flying = (fine > leave) & (fine < leave + air)
    acceleration += np.where(flying, -g, 0.0)
    acceleration += pulse(leave + air, land, 2 * v / land)
    acceleration = np.convolve(np.pad(acceleration, 20, "edge"), np.ones(41) / 41, "valid")  # what flesh lets through
    speed = np.cumsum(acceleration) * 1e-3
    up = np.cumsum(speed) * 1e-3
    return np.stack([0.05 * t, np.interp(t, fine, up), 0.0 * t], -1)


def bus(t, rng):
    """Speeds up by 1.5 m/s², brakes by 3 m/s² 2 s later, and shakes by a millimetre at 3 Hz."""
    fine = np.arange(0, t[-1] + 1e-3, 1e-3)
    first = rng.uniform(0.2, 0.5)

    def ramp(begin, end, size):
        return size * (np.clip((fine - begin) / 0.3, 0, 1) - np.clip((fine - end) / 0.3, 0, 1))

    acceleration = ramp(first, first + 1.0, 1.5) + ramp(first + 1.5, first + 2.2, -3.0)
    along = np.cumsum(5.0 + np.cumsum(acceleration) * 1e-3) * 1e-3
    return np.stack([np.interp(t, fine, along), 0.001 * np.sin(2 * np.pi * 3 * t), 0.0 * t], -1)


MOTIONS = {each.__name__: each for each in (still, walking, running, jumping, bus)}


def derivatives(values: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """First and second ones of values (T, n) on a fine grid."""
    first = np.gradient(values, dt, axis=0)
    return first, np.gradient(first, dt, axis=0)


def recorded(motion: str, dimensions: int, seed: int) -> tuple[Recording, Truth]:
    """Keypoints with noise, and the torques that MuJoCo says."""
    rng = np.random.default_rng([seed, dimensions])
    body = person(dimensions)
    played = Carried(body)
    fine = np.arange(-0.05, SECONDS + 0.05, 1e-3)
    rows = np.arange(50, len(fine) - 50, round(1000 / RATE))
    K = body.num_joints
    rest = [-1.2, 0.9] if dimensions == 2 else [-1.1, 0.3, 0.8, 0.5]
    q = np.tile(rest, (len(fine), 1)).astype(float)
    for _ in range(3):
        rate, phase, size = rng.uniform(0.3, 1.5, K), rng.uniform(0, 2 * np.pi, K), rng.uniform(0.1, 0.25, K)
        q += size * np.sin(2 * np.pi * rate * fine[:, None] + phase)
    if motion == "falling":
        at = fine[rows]
        first, rates = q[0], np.zeros(K) + rng.uniform(-2, 2, K)
        short = at[at < 0.8]
        q, b = played.falling(short, first, rates)
        return _seen(body, played, short, b, q, np.zeros((len(short), K)), rng)
    b = MOTIONS[motion](fine - fine[0], rng)[:, :dimensions]
    qd, qdd = derivatives(q, 1e-3)
    _, pushed = derivatives(b, 1e-3)
    torque = played.torque(q[rows], qd[rows], qdd[rows], pushed[rows])
    return _seen(body, played, fine[rows], b[rows], q[rows], torque, rng)


def _seen(body, played, at, b, q, torque, rng) -> tuple[Recording, Truth]:
    points = played.points(b, q)
    points = points + NOISE * rng.standard_normal(points.shape)
    names = ("shoulder", *body.keypoint_names)
    truth = Truth(time=at, torque=torque, angle=q, velocity=np.gradient(q, at, axis=0), joint_names=body.joint_names)
    return Recording(at, points, names, name="arm"), truth


def scored(motion: str, dimensions: int, seed: int, how: str, method: str) -> dict:
    """Error and coverage of one recording."""
    recording, truth = recorded(motion, dimensions, seed)
    body = person(dimensions)
    if how == "at rest":
        recording = recording.relative_to("shoulder").with_keypoints(body.keypoint_names)
    begin = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = infer(recording, body, method=method, seed=seed)
    seconds = time.monotonic() - begin
    draws = pooled(found)["torque"].transpose("sample", "time", "joint").values
    low, middle, high = np.quantile(draws, [0.05, 0.5, 0.95], axis=0)
    true = truth.torque
    return {
        "motion": motion,
        "dimensions": dimensions,
        "seed": seed,
        "how": how,
        "rms": float((true**2).mean()),
        "error": float(((middle - true) ** 2).mean()),
        "width": float(((high - low) / 2).mean()),
        "held": ((low <= true) & (true <= high)).mean(0).tolist(),
        "moves": "base_position" in found["posterior"],
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--method", default="smc")
    parser.add_argument("--results", type=Path)
    parser.add_argument("--cases", nargs="*")
    options = parser.parse_args()
    cases = options.cases or [f"{motion}/{d}" for d in (2, 3) for motion in (*MOTIONS, "falling")]
    known = {}
    if options.results and options.results.exists():
        known = {tuple(each["key"]): each for each in map(json.loads, options.results.read_text().splitlines())}
    print("| base | space | handled as | moves | torque, rms N·m | error, rms N·m | ± 90 % | 90 % holds | s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for case in cases:
        motion, dimensions = case.split("/")
        for how in ("default", "at rest"):
            found = []
            for seed in range(options.seeds):
                key = (motion, int(dimensions), how, seed, options.method)
                if key not in known:
                    known[key] = scored(motion, int(dimensions), seed, how, options.method) | {"key": key}
                    if options.results:
                        options.results.parent.mkdir(parents=True, exist_ok=True)
                        with options.results.open("a") as file:
                            file.write(json.dumps(known[key]) + "\n")
                found.append(known[key])
            mean = {name: np.mean([each[name] for each in found]) for name in ("rms", "error", "width", "seconds")}
            print(
                f"| {motion} | {'plane' if dimensions == '2' else 'space'} | {how} "
                f"| {sum(each['moves'] for each in found)} of {len(found)} | {mean['rms'] ** 0.5:.2f} "
                f"| {mean['error'] ** 0.5:.3f} | {mean['width']:.2f} "
                f"| {np.mean([each['held'] for each in found]):.2f} | {mean['seconds']:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
