"""The walker's swinging right arm in 3-D from subsets of four cameras: from the pixels, and from triangulated points.

`multiview_walker` (60 frames/s, 100 frames, MediaPipe). The arm hangs on a shoulder that is carried about. Lengths of
upper arm and forearm, noise, and what lasts of the tracker's errors are fitted by marginal likelihood; torques' size is
given. Both ways get the same cameras and tracks, whose left and right are put in order first, each camera by itself.
Pixels have one thing more: each camera may be rotated about its place, by a prior of `TURN`. Triangulated points leave
all keypoints of a camera off together, by up to 13 px, and half a degree a camera explains that.

The arm was not measured: what counts is that subsets agree with all four cameras within their stated intervals, and
that a camera that was left out is predicted at the nominal rate. It is rotated by an unknown amount, and its noise is
that of a camera and a keypoint that were used. Intervals are of the posterior: lengths and noise are drawn from the
fit's Gaussian, turns and paths given those. Masses are textbook ones, so torques are known but for a factor.

    INVDYN_DATA=… python benchmarks/walker_arm.py [--subsets 1234 123 …] [--every 1] [--results FILE]
"""

import argparse
import os
import time
from functools import partial
from pathlib import Path

import numpy as np
import torch
from kept import kept
from laplace_evidence import fit_at_mode
from walker import tracks

from invdyn.inference.fitting.log_parameters import Free, LogParameters
from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.models import Body, Joint, Learned, Link
from invdyn.models.observation.pinhole import moved, project
from invdyn.recordings import Recording
from invdyn.recordings.cameras import Calibration, Views, filmed, read_calibration, sides_kept, triangulate

SUBSETS = ("1234", "123", "234", "13", "24")
ALL = SUBSETS[0]
WAYS = ("pixels", "points")
NAMES = ("L_shoulder", "L_elbow", "L_wrist", "R_shoulder", "R_elbow", "R_wrist", "L_hip", "R_hip")
OWN = ("shoulder", "elbow", "wrist")
AWAY = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
"""Where all angles are zero the arm points to the walker's right: the motion is about there, far from the poles."""
RATE = 60.0
TURN = 0.01
"""rad about each axis, 17 px: how far off a camera's stated orientation may be."""
TORQUE = {"torque.scale": [60.0, 60.0, 150.0, 5.0, 5.0, 1.0, 2.5], "torque.decay": 4.0}
"""N and N·m: what carries the shoulder carries a trunk's weight; a swinging arm takes some N·m."""
DRAWS, EACH = 16, 15
"""Of what was fitted, and of paths for each."""
MOST = 10
"""Steps of the fit."""
WITHIN = 1.645
FREE = ("emission.pixel_scale", "emission.bias_scale", "emission.bias_time", "emission.keypoint_scale")


def arm() -> Body:
    """Carried shoulder, upper arm and forearm of 2 and 1.3 kg, as de Leva (1996) has them of a body of 75 kg."""
    ball, upper, fore = (
        (*each, 0.0, 0.0, 0.0) for each in ((0.1, 0.1, 0.1), (0.004, 0.017, 0.017), (0.002, 0.011, 0.011))
    )
    place = {"shoulder": (0.0, 0.0, 0.0)}
    trunk = Link("trunk", Joint("carried", "translation"), mass=10.0, inertia=ball, sites=place)
    upper_arm = Link(
        "upper_arm",
        Joint("shoulder", "ball"),
        parent="trunk",
        origin=(0.0, 0.0, 0.0),
        rotation=AWAY,
        length=Learned(0.3),
        tip="elbow",
        mass=2.0,
        inertia=upper,
    )
    forearm = Link(
        "forearm", Joint("elbow"), parent="upper_arm", length=Learned(0.3), tip="wrist", mass=1.3, inertia=fore
    )
    return Body("right arm", [trunk, upper_arm, forearm])


def film(every: int) -> Views:
    """The right arm in all cameras, left and right in order."""
    folder = Path(os.environ["INVDYN_DATA"]).expanduser() / "multiview_walker"
    calibration = read_calibration(folder / "Calib.qca.txt")
    pixels, confidence = (each.swapaxes(1, 2) for each in tracks(folder, calibration.names))
    whole, rotated = sides_kept(Views(calibration, np.arange(len(pixels)) / RATE, pixels, confidence, NAMES))
    print(f"Rows in which left and right were exchanged, a camera: {', '.join(map(str, rotated.sum(0)))}.\n")
    right = whole.select([f"R_{name}" for name in OWN]).at(slice(None, None, every))
    return Views(calibration, right.time, right.pixels, right.confidence, OWN)


def seen_by(cameras: list[int], views: Views) -> Views:
    """What some of the cameras saw."""
    some = views.calibration.select([views.calibration.names[c] for c in cameras])
    return Views(some, views.time, views.pixels[:, cameras], views.confidence[:, cameras], views.keypoint_names)


def problem_of(way: str, views: Views) -> tuple[Problem, list[Free]]:
    recording: Recording = filmed(views)
    cameras: tuple[str, ...] = ("turn",)
    if way == "points":
        cameras = ()
        recording = Recording(recording.time, recording.keypoints, OWN, recording.confidence)
    start = {**TORQUE, "initial.angle_scale": 1.0, **({"camera.turn_scale": TURN} if way == "pixels" else {})}
    problem = arm_problem(recording, arm(), family="student_t", substeps=1, parameters=start, learn_cameras=cameras)
    model = problem.model
    free = [Free(name, tied=True, sd=1.0) for name in FREE if name in model.parameters]
    free += [Free(f"body.{name}", sd=0.3, entries=own) for name, own in model.body.learned.items()]
    return problem, free


def reprojected(calibration: Calibration, points: torch.Tensor, turn: torch.Tensor) -> torch.Tensor:
    """Pixels (N, T, C, P, 2) of points (N, T, P, 3) in cameras rotated by (N, C, 3)."""
    cameras = moved(pinhole(calibration), turn[:, None], torch.zeros_like(turn[:, None]))
    return project(cameras, points)[0]


def missed(calibration: Calibration, points: torch.Tensor, turn: torch.Tensor, views: Views) -> float:
    """Median distance of the mean projection from the pixels, px."""
    off = reprojected(calibration, points, turn).mean(0).numpy() - views.pixels
    return float(np.nanmedian(np.linalg.norm(off, axis=-1)))


def covered(expected: torch.Tensor, white: torch.Tensor, lasting: torch.Tensor, df: float, views: Views) -> float:
    """Share of pixels (T, C, P, 2) within 90 % of the N draws ``expected``, with noise of a used camera's keypoint.

    ``white`` and ``lasting`` (N, ·) are σ and β of those that were used, by draw; what lasts is marginal.
    """
    count, _, cameras, points, _ = expected.shape
    # Of each draw, camera and keypoint one size: it is not known which one of those used it is like.
    which = torch.randint(white.shape[1], (count, cameras * points))
    sizes = [each.gather(1, which).reshape(count, 1, cameras, points, 1) for each in (white, lasting)]
    outliers = torch.distributions.StudentT(df, 0.0, 1.0).sample(expected.shape)
    drawn = expected + sizes[0] * outliers + sizes[1] * torch.randn_like(expected)
    low, high = (torch.quantile(drawn, q, dim=0).numpy() for q in (0.05, 0.95))
    known = np.isfinite(views.pixels)
    return float(((low <= views.pixels) & (views.pixels <= high))[known].mean())


def answer(way: str, used: Views, rest: Views | None) -> dict:
    """Fit, draw, and the summary of the draws: means and deviations of lengths, angles and torques; errors, px."""
    started = time.process_time()
    problem, free = problem_of(way, used)
    found = fit_at_mode(problem.model, problem.observations, free, max_iterations=MOST)
    parameters = LogParameters(problem.model, free)
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(found.covariance)
    torch.manual_seed(0)
    lengths, paths, points, turns, white, lasting = [], [], [], [], [], []
    for _ in range(DRAWS):
        drawn = root @ rng.standard_normal(len(root))
        model = parameters.at(torch.as_tensor(found.phi + drawn))
        smoother = gauss_newton(model, problem.observations, start=found.path, max_iterations=15)
        each = GaussianChain.of(smoother).sample((EACH,))
        numbers, p = model.body_parameters(), model.parameters
        lengths += [numbers.sites[1:, 0]] * EACH
        paths.append(each)
        points.append(model.dynamics.keypoints(model.split(each)[1], numbers))
        if way == "pixels":
            memory = model.layout.parted(model.split(each)[0])[2]
            turns += list(memory[:, 0, model.observation.pixels.independent_states :].unflatten(-1, (-1, 3)))
            white += [p["emission.pixel_scale"].flatten()] * EACH
            lasting += [p["emission.bias_scale"].flatten()] * EACH
    seconds = time.process_time() - started
    path, seen = torch.cat(paths), torch.cat(points)
    if way == "points":
        sigma = triangulate(used.calibration, *used.flat()).scale
        turns = [torch.zeros(len(used.calibration), 3, dtype=seen.dtype)] * len(seen)
        white, lasting = [torch.full((1,), sigma, dtype=seen.dtype)] * len(seen), [torch.zeros(1)] * len(seen)
    whole = {
        "lengths": torch.stack(lengths),
        "angles": problem.model.split(path)[1][..., 3:],
        "torques": path[..., 3:7],
    }
    reported: dict = {name: [each.mean(0).tolist(), each.std(0).tolist()] for name, each in whole.items()}
    reported["noise"] = [float(torch.stack(each).median()) for each in (white, lasting)]
    reported["converged"], reported["s"] = found.converged, seconds
    reported["turns"] = torch.stack(turns).mean(0).tolist()
    reported["used"] = missed(used.calibration, seen, torch.stack(turns), used)
    if rest is not None:
        other = TURN * torch.randn(len(seen), len(rest.calibration), 3, dtype=seen.dtype)
        reported["left out"] = missed(rest.calibration, seen, torch.zeros_like(other), rest)
        df = float(problem.model.parameters["emission.df"])
        expected = reprojected(rest.calibration, seen, other)
        reported["covered"] = covered(expected, torch.stack(white), torch.stack(lasting), df, rest)
    return reported


def apart(one: dict, other: dict, name: str) -> np.ndarray:
    """Differences of two answers in both their standard deviations."""
    (a, sa), (b, sb) = (np.array(each[name]) for each in (one, other))
    return np.abs(a - b) / np.hypot(sa, sb)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subsets", nargs="+", default=list(SUBSETS), choices=SUBSETS)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--results", type=Path)
    given = parser.parse_args()
    torch.set_num_threads(1)
    views = film(given.every)
    found: dict[tuple[str, str], dict] = {}
    print(
        "| cameras | from | upper arm, m | forearm, m | used, px | left out, px | of it in 90 % | torques' sd, N·m "
        f"| σ, β, px | CPU s |\n{'|---' * 10}|"
    )
    for subset in given.subsets:
        cameras = [int(digit) - 1 for digit in subset]
        others = [c for c in range(len(views.calibration)) if c not in cameras]
        rest = seen_by(others, views) if others else None
        for way in WAYS:
            case = f"{subset}, {way}, {given.every}"
            reported = kept(given.results, case, partial(answer, way, seen_by(cameras, views), rest))
            found[subset, way] = reported
            lengths = [f"{mean:.3f} ± {sd:.3f}" for mean, sd in zip(*reported["lengths"], strict=True)]
            out = ["", ""] if rest is None else [f"{reported['left out']:.1f}", f"{reported['covered']:.2f}"]
            torques = " ".join(f"{sd:.2f}" for sd in np.mean(reported["torques"][1], axis=0))
            cells = [subset, way, *lengths, f"{reported['used']:.1f}", *out, torques]
            cells += ["{:.1f}, {:.1f}".format(*reported["noise"]), f"{reported['s']:.0f}"]
            print(f"| {' | '.join(cells)} |", flush=True)
    print(f"\nApart from all four cameras, in both standard deviations, and the share below {WITHIN}:\n")
    print("| cameras | from | upper arm | forearm | angles | torques |\n|---|---|---|---|---|---|")
    for (subset, way), reported in found.items():
        if subset != ALL and (ALL, way) in found:
            z = [f"{each:.1f}" for each in apart(reported, found[ALL, way], "lengths")]
            z += [f"{(apart(reported, found[ALL, way], name) < WITHIN).mean():.2f}" for name in ("angles", "torques")]
            print(f"| {subset} | {way} | {' | '.join(z)} |")


if __name__ == "__main__":
    main()
