"""Torques in 3-D from simulated cameras: are the intervals as wide as they say?

An arm of two links in space, driven by random torques, is seen at 30 frames a second by cameras on a circle of 3 m.
Each detection is off by noise, Student-t with 4 degrees of freedom, by an error that lasts, an Ornstein–Uhlenbeck
process of its own, and one in twenty is missing. Cases: two, three and four cameras; four, which all lose the elbow for
a third of the film ("hidden"); four, of which one has a clock 20 ms ahead that is to be found ("clock").

Coverage is of 90 % intervals of all joints' torques, angles, and of points, over all rows and seeds, with noise and
torques' size as simulated (`--fit`: fitted by marginal likelihood, at ten times the cost). "white": the same with all
errors taken for white, of the same size. "points": triangulated, then inferred, with noise from jitter and misfit.

    python benchmarks/simulated_cameras.py [--seeds 20] [--cases two three …] [--fit] [--results FILE]

With `--results` a line a seed is kept, and the same call continues where it was stopped.
"""

import argparse
import time
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import torch
from kept import kept
from projection import cameras_around

from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.marginal_likelihood import fit
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import ArmModel, Body, Joint, Keypoints, Link, Observation
from invdyn.recordings import Recording
from invdyn.recordings.cameras import Calibration, Camera, Filmed, Views, filmed, project

FRAMES, RATE, FINE = 45, 30.0, 6
"""Rows, per second, and simulated moments in each."""
NOISE, BIAS, LASTS, LOST = 1.5, 6.0, 0.3, 0.05
"""px, px, s, and the share of detections that are missing."""
OFFSET = 0.02
FARTHEST = 1.2
"""rad, of a pitch: motions through a pole of their angles, at a quarter turn, are drawn again."""
HANGING = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))
KEYPOINTS = ("elbow", "wrist")
TORQUE = {"torque.scale": 0.7, "torque.decay": 4.0}
KNOWN = {**TORQUE, "emission.pixel_scale": NOISE, "emission.bias_scale": BIAS, "emission.bias_time": LASTS}
CASES = {"two": (2, "pixels"), "three": (3, "pixels"), "four": (4, "pixels"), "hidden": (4, "pixels")}
CASES |= {"clock": (4, "pixels"), "two, white": (2, "white"), "four, white": (4, "white")}
CASES |= {"two, points": (2, "points"), "four, points": (4, "points")}
DRAWS = 400


def arm() -> Body:
    """Links of .3 and .25 m."""
    upper = Link(
        "upper",
        Joint("shoulder", "universal"),
        rotation=HANGING,
        length=0.3,
        tip="elbow",
        mass=2.0,
        inertia=(0.003, 0.015, 0.015, 0.0, 0.0, 0.0),
    )
    own = (0.002, 0.008, 0.008, 0.0, 0.0, 0.0)
    fore = Link("fore", Joint("elbow", "universal"), parent="upper", length=0.25, tip="wrist", mass=1.2, inertia=own)
    return Body("arm", [upper, fore])


def motion(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,), torques and angles (N, 4), and points (N, 2, 3), `FINE` moments a row."""
    moments = np.arange(FRAMES * FINE) / (FINE * RATE)
    start = {"initial.angle": [0.1, 0.1, 0.4, 0.2], "initial.angle_scale": 0.2, "initial.velocity_scale": 0.5}
    own = {**TORQUE, **start, "noise.angle": 1e-6, "noise.velocity": 1e-6}
    model = ArmModel(arm(), moments, Observation(Keypoints(KEYPOINTS)), parameters=own)
    for attempt in count():
        torch.manual_seed(1000 * seed + attempt)
        states, _ = model.simulate()
        angles = model.split(states)[1]
        if angles[:, [1, 3]].abs().max() < FARTHEST:
            break
    points = model.dynamics.keypoints(angles, model.body_parameters())
    return moments, states[:, :4].numpy(), angles.numpy(), points.numpy()


def looking_in(count: int) -> list[Camera]:
    """Some of the cameras on a circle, two of them at right angles."""
    four = cameras_around(4)
    return [replace(camera, name=f"cam{k + 1}") for k, camera in enumerate(four)][:count]


def seen(case: str, seed: int, moments: np.ndarray, points: np.ndarray) -> Views:
    """What its cameras' trackers give."""
    cameras = looking_in(CASES[case][0])
    rng = np.random.default_rng(seed)
    rows = np.arange(FRAMES) * FINE
    late = np.zeros(len(cameras))
    if case == "clock":
        late[-1] = OFFSET
    pixels = []
    for camera, offset in zip(cameras, late, strict=True):
        shown = np.stack(
            [np.interp(moments[rows] - offset, moments, column) for column in points.reshape(len(points), -1).T], -1
        )
        pixels.append(project(camera, shown.reshape(-1, 2, 3)))
    whole = np.stack(pixels, 1)
    lasting = BIAS * rng.standard_normal(whole.shape)
    keep = np.exp(-1 / (RATE * LASTS))
    for t in range(1, FRAMES):
        lasting[t] = keep * lasting[t - 1] + np.sqrt(1 - keep**2) * lasting[t]
    whole = whole + lasting + NOISE * rng.standard_t(4.0, whole.shape)
    whole[rng.random(whole.shape[:3]) < LOST] = np.nan
    if case == "hidden":
        whole[FRAMES // 3 : 2 * FRAMES // 3, :, 0] = np.nan
    return Views(Calibration(tuple(cameras), True), moments[rows], whole, np.ones(whole.shape[:3]), KEYPOINTS)


def problem_of(case: str, views: Views) -> Problem:
    recording: Recording = filmed(views)
    way = CASES[case][1]
    options = {"family": "student_t", "substeps": 2}
    if way == "points":
        recording = Recording(recording.time, recording.keypoints, KEYPOINTS)
        return arm_problem(recording, arm(), parameters=dict(TORQUE), **options)
    assert isinstance(recording, Filmed)
    known = dict(KNOWN)
    if way == "white":
        known |= {"emission.pixel_scale": float(np.hypot(NOISE, BIAS)), "emission.bias_scale": 1e-3}
    clocks = ("offset",) if case == "clock" else ()
    return arm_problem(recording, arm(), parameters=known, learn_cameras=clocks, **options)


def free_of(problem: Problem, whole: bool) -> list[Free]:
    names = [
        "torque.scale",
        "emission.pixel_scale",
        "emission.bias_scale",
        "emission.bias_time",
        "emission.keypoint_scale",
    ]
    every = [Free(name, tied=True, sd=1.0) for name in names if whole and name in problem.model.parameters]
    if "camera.offset" in problem.model.parameters:
        every.append(Free("camera.offset", sd=1.0, entries=(3,), unit=0.05))
    return every


def run(case: str, seed: int, whole: bool) -> dict[str, float]:
    """Shares of the truth within 90 % intervals, errors and stated sds, the clock's offset and sd (ms), CPU s."""
    moments, torque, angle, points = motion(seed)
    rows = np.arange(FRAMES) * FINE
    started = time.process_time()
    problem = problem_of(case, seen(case, seed, moments, points))
    model, start = problem.model, None
    reported: dict[str, float] = {}
    if free := free_of(problem, whole):
        found = fit(model, problem.observations, free)
        model, start = found.model, found.path
        if case == "clock":
            reported["offset"] = 1e3 * float(model.parameters["camera.offset"][3])
            reported["offset sd"] = 50 * float(found.log_sd["camera.offset"][0])
    smoother = gaussian_smoother(model, problem.observations, start)
    torch.manual_seed(0)
    paths = GaussianChain.of(smoother).sample((DRAWS,))
    reported["s"] = time.process_time() - started
    q = model.split(paths)[1]
    own = {"torque": paths[..., :4], "angle": q, "point": model.dynamics.keypoints(q, model.body_parameters())}
    for (name, draws), true in zip(own.items(), (torque, angle, points), strict=True):
        low, high = np.quantile(draws.numpy(), [0.05, 0.95], axis=0)
        reported[name] = float(((low <= true[rows]) & (true[rows] <= high)).mean())
        reported[f"{name} error"] = float(np.sqrt(((draws.numpy().mean(0) - true[rows]) ** 2).mean()))
        reported[f"{name} sd"] = float(np.sqrt(draws.numpy().var(0).mean()))
    return reported


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--fit", action="store_true")
    parser.add_argument("--results", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(
        "| case | seeds | torque in 90 % | angle | point | torque error, sd, N·m | point error, sd, mm | offset, ms "
        "| CPU s |"
    )
    print("|---" * 9 + "|")
    for case in given.cases:
        fitted = ", fit" if given.fit else ""
        reported = [
            kept(given.results, f"{case}{fitted}, {k}", partial(run, case, k, given.fit)) for k in range(given.seeds)
        ]
        mean = {name: np.mean([each[name] for each in reported]) for name in reported[0]}
        spread = np.std([each["torque"] for each in reported]) / np.sqrt(len(reported))
        clock = ""
        if case == "clock":
            values = [each["offset"] for each in reported]
            clock = f"{mean['offset']:.1f} ± {np.std(values):.1f}, stated {mean['offset sd']:.1f}"
        print(
            f"| {case} | {len(reported)} | {mean['torque']:.3f} ± {spread:.3f} | {mean['angle']:.3f} | "
            f"{mean['point']:.3f} | "
            f"{mean['torque error']:.2f}, {mean['torque sd']:.2f} | "
            f"{1e3 * mean['point error']:.1f}, {1e3 * mean['point sd']:.1f} | {clock} | {mean['s']:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
