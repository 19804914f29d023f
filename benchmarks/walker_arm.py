"""The walker's swinging right arm in 3-D from subsets of four cameras: from the pixels, and from triangulated points.

`multiview_walker` (60 frames/s, 100 frames, MediaPipe). The arm hangs on a shoulder that is carried about; lengths of
upper arm and forearm, noise, what lasts of the tracker's errors and the torques' size are fitted by marginal likelihood
in both, which get the same cameras, and nothing else. Nobody measured the arm: what counts is that subsets agree within
their stated intervals, and that a camera which was left out is predicted at the nominal rate. Intervals are of the
posterior, lengths and noise drawn from the fit's Gaussian. The scene is metric by its calibration; masses are textbook
ones, so that torques are known but for their factor.

    INVDYN_DATA=… python benchmarks/walker_arm.py [--subsets 1234 123 234 13 24] [--every 1]
"""

import argparse
import os
import time
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
import torch
from walker import tracks

from invdyn.inference.fitting.marginal_likelihood import Free, LogParameters, fit
from invdyn.inference.posterior.cameras import pinhole
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.models import Joint, Learned, SpatialLink, Tree
from invdyn.models.observation.pinhole import project
from invdyn.recordings import Recording
from invdyn.recordings.cameras import Calibration, Views, filmed, read_calibration

KEYPOINTS = ("shoulder", "elbow", "wrist")
RIGHT = (3, 4, 5)
"""Columns of theirs among the eight."""
AWAY = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
"""Where all angles are zero the arm points to the walker's right: the motion is about there, far from the poles."""
RATE = 60.0
DRAWS, EACH = 16, 10
"""Of lengths and noise, and of paths for each."""


def arm() -> Tree:
    """Carried shoulder, upper arm and forearm of 2 and 1.3 kg, as de Leva (1996) has them of a body of 75 kg."""
    ball = (0.1, 0.1, 0.1, 0.0, 0.0, 0.0)
    links = [
        SpatialLink(
            "trunk", Joint("carried", "translation"), mass=10.0, inertia=ball, sites={"shoulder": (0.0, 0.0, 0.0)}
        ),
        SpatialLink(
            "upper_arm",
            Joint("shoulder", "universal"),
            "trunk",
            origin=(0.0, 0.0, 0.0),
            rotation=AWAY,
            length=Learned(0.3),
            tip="elbow",
            mass=2.0,
        ),
        SpatialLink("forearm", Joint("elbow", "universal"), "upper_arm", length=Learned(0.3), tip="wrist", mass=1.3),
    ]
    return Tree("right arm", links)


def film(subset: list[int], calibration: Calibration, pixels: np.ndarray, confidence: np.ndarray, every: int) -> Views:
    """What some of the cameras saw."""
    some = calibration.select([calibration.names[c] for c in subset])
    shown, sure = (each[::every][:, list(RIGHT)][:, :, subset].swapaxes(1, 2) for each in (pixels, confidence))
    return Views(some, every * np.arange(len(shown)) / RATE, shown, sure, KEYPOINTS)


@dataclass
class Answer:
    """Of one subset by one way: draws of lengths (N, 2) m, angles and torques (N, T, 4), points (N, T, 3, 3), and CPU s."""

    lengths: np.ndarray
    angles: np.ndarray
    torques: np.ndarray
    points: torch.Tensor
    noise: tuple[float, float, float]
    seconds: float


def free_of(problem: Problem) -> list[Free]:
    names = [
        "torque.scale",
        "emission.pixel_scale",
        "emission.bias_scale",
        "emission.bias_time",
        "emission.keypoint_scale",
        "emission.pixel_confidence_slope",
        "emission.confidence_slope",
    ]
    tied = [Free(name, tied=True, sd=1.0) for name in names if name in problem.model.parameters]
    return [*tied, *(Free(f"body.{name}", sd=0.3, entries=own) for name, own in problem.model.body.learned.items())]


def answer(problem: Problem) -> Answer:
    """Fit, and draw from the posterior."""
    begun = time.process_time()
    found = fit(problem.model, problem.observations, free_of(problem))
    parameters = LogParameters(problem.model, free_of(problem))
    rng = np.random.default_rng(0)
    root = np.linalg.cholesky(found.covariance)
    lengths, paths, points = [], [], []
    torch.manual_seed(0)
    for _ in range(DRAWS):
        model = parameters.at(torch.as_tensor(found.phi + root @ rng.standard_normal(len(root))))
        smoother = gauss_newton(model, problem.observations, start=found.path, max_iterations=15)
        drawn = GaussianChain.of(smoother).sample((EACH,))
        numbers = model.body_parameters()
        lengths += [numbers.sites[1:, 0].numpy()] * EACH
        paths.append(drawn)
        points.append(model.dynamics.keypoints(model.split(drawn)[1], numbers))
    path = torch.cat(paths)
    p = found.model.parameters
    lasting = [float(p[f"emission.bias_{name}"].median()) if f"emission.bias_{name}" in p else 0.0 for name in ("scale", "time")]
    noise = float(p["emission.pixel_scale"].median()) if "emission.pixel_scale" in p else 0.0
    return Answer(
        np.stack(lengths),
        problem.model.split(path)[1][..., 3:].numpy(),
        path[..., 3:7].numpy(),
        torch.cat(points),
        (noise, *lasting),
        time.process_time() - begun,
    )


def reprojected(calibration: Calibration, points: torch.Tensor) -> torch.Tensor:
    """(N, C, T, P, 2)."""
    return project(pinhole(calibration), points.flatten(1, 2))[0].unflatten(2, points.shape[1:3])


def covered(found: Answer, views: Views, noise: tuple[float, float, float]) -> float:
    """Share of pixels of cameras that were left out within their 90 % intervals."""
    torch.manual_seed(1)
    expected = reprojected(views.calibration, found.points).movedim(1, 2)
    white, lasting, _ = noise
    strays = torch.distributions.StudentT(4.0, 0.0, max(white, 1e-6)).sample(expected.shape)
    drawn = expected + strays + lasting * torch.randn_like(expected)
    low, high = (torch.quantile(drawn, q, dim=0).numpy() for q in (0.05, 0.95))
    known = np.isfinite(views.pixels)
    return float(((low <= views.pixels) & (views.pixels <= high))[known].mean())


def agreement(one: np.ndarray, other: np.ndarray) -> float:
    """Share of numbers of two answers that differ by less than 1.645 of both their standard deviations."""
    apart = np.abs(one.mean(0) - other.mean(0)) / np.hypot(one.std(0), other.std(0))
    return float((apart < 1.645).mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--subsets", nargs="+", default=["1234", "123", "234", "13", "24"])
    parser.add_argument("--every", type=int, default=1)
    given = parser.parse_args()
    torch.set_num_threads(1)
    folder = Path(os.environ["INVDYN_DATA"]).expanduser() / "multiview_walker"
    calibration = read_calibration(folder / "Calib.qca.txt")
    pixels, confidence = tracks(folder, calibration.names)
    found: dict[str, dict[str, Answer]] = {"pixels": {}, "points": {}}
    print("| cameras | from | upper arm, m | forearm, m | used, px | left out, px | covered at 90 % | torque sd, N·m | σ, β px, ℓ s | CPU s |")
    print("|---" * 10 + "|")
    for subset in given.subsets:
        used = [int(digit) - 1 for digit in subset]
        views = film(used, calibration, pixels, confidence, given.every)
        recording = filmed(views)
        plain = Recording(recording.time, recording.keypoints, KEYPOINTS, recording.confidence)
        for way, each in (("pixels", recording), ("points", plain)):
            problem = arm_problem(each, arm(), family="student_t", substeps=1, parameters={"torque.decay": 4.0})
            own = found[way][subset] = answer(problem)
            mean, sd = own.lengths.mean(0), own.lengths.std(0)
            middle = own.points.mean(0, keepdim=True)
            errors = []
            rest = film([c for c in range(4) if c not in used], calibration, pixels, confidence, given.every) if len(used) < 4 else None
            for side in (views, rest):
                off = np.nan if side is None else reprojected(side.calibration, middle)[0].movedim(0, 1).numpy() - side.pixels
                errors.append("" if side is None else f"{np.nanmedian(np.linalg.norm(off, axis=-1)):.1f}")
            share = "" if rest is None else f"{covered(own, rest, found['pixels'][subset].noise if way == 'pixels' else (triangulated_noise(views), 0.0, 0.0)):.2f}"
            torque = " ".join(f"{each:.2f}" for each in own.torques.std(0).mean(0))
            noise = " ".join(f"{each:.2f}" for each in own.noise)
            lengths = " | ".join(f"{m:.3f} ± {s:.3f}" for m, s in zip(mean, sd, strict=True))
            print(f"| {subset} | {way} | {lengths} | {errors[0]} | {errors[1]} | {share} | {torque} | {noise} | {own.seconds:.0f} |", flush=True)
    print("\nShare within 1.645 of both standard deviations, nominally .90 where no camera is shared and more where one is:\n")
    print("| subsets | from | lengths apart, sd | angles | torques |\n|---|---|---|---|---|")
    for one, other in combinations(given.subsets, 2):
        for way, own in found.items():
            a, b = own[one], own[other]
            z = np.abs(a.lengths.mean(0) - b.lengths.mean(0)) / np.hypot(a.lengths.std(0), b.lengths.std(0))
            print(f"| {one}, {other} | {way} | {z[0]:.1f} {z[1]:.1f} | {agreement(a.angles, b.angles):.2f} | {agreement(a.torques, b.torques):.2f} |")


def triangulated_noise(views: Views) -> float:
    """σ of a pixel that triangulation finds, px."""
    from invdyn.recordings.cameras import triangulate

    return triangulate(views.calibration, *views.flat()).scale


if __name__ == "__main__":
    main()
