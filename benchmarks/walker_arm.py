"""The walker's swinging right arm in 3-D from subsets of four cameras: from the pixels, and from triangulated points.

`multiview_walker` (60 frames/s, 100 frames, MediaPipe). The arm hangs on a shoulder that is carried about; lengths of
upper arm and forearm, noise, and what lasts of the tracker's errors are fitted by marginal likelihood in both ways,
which get the same cameras, and nothing else; torques' size is given. Nobody measured the arm: what counts is that
subsets agree within their stated intervals, and that a camera which was left out is predicted at the nominal rate.
Intervals are of the posterior, lengths and noise drawn from the fit's Gaussian. The scene is metric by its
calibration; masses are textbook ones, so that torques are known but for their factor.

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
from invdyn.recordings.cameras import Calibration, Views, filmed, read_calibration, triangulate

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
            inertia=(0.004, 0.017, 0.017, 0.0, 0.0, 0.0),
        ),
        SpatialLink(
            "forearm",
            Joint("elbow", "universal"),
            "upper_arm",
            length=Learned(0.3),
            tip="wrist",
            mass=1.3,
            inertia=(0.002, 0.011, 0.011, 0.0, 0.0, 0.0),
        ),
    ]
    return Tree("right arm", links)


def film(subset: list[int], calibration: Calibration, pixels: np.ndarray, confidence: np.ndarray, every: int) -> Views:
    """What some of the cameras saw."""
    some = calibration.select([calibration.names[c] for c in subset])
    shown, sure = (each[::every][:, list(RIGHT)][:, :, subset].swapaxes(1, 2) for each in (pixels, confidence))
    return Views(some, every * np.arange(len(shown)) / RATE, shown, sure, KEYPOINTS)


@dataclass
class Answer:
    """Of one subset by one way: draws of N lengths (N, 2) m, angles and torques (N, T, 4), points (N, T, 3, 3).

    `noise` is σ and β, px, and CPU s are told.
    """

    lengths: np.ndarray
    angles: np.ndarray
    torques: np.ndarray
    points: torch.Tensor
    noise: tuple[float, float]
    seconds: float


FREE = ("emission.pixel_scale", "emission.bias_scale", "emission.keypoint_scale")
TORQUE = {"torque.scale": [60.0, 60.0, 150.0, 5.0, 5.0, 2.5, 2.5], "torque.decay": 4.0}
"""N and N·m: what carries the shoulder bears a trunk's weight; a swinging arm takes some N·m."""


def free_of(problem: Problem) -> list[Free]:
    tied = [Free(name, tied=True, sd=1.0) for name in FREE if name in problem.model.parameters]
    return [*tied, *(Free(f"body.{name}", sd=0.3, entries=own) for name, own in problem.model.body.learned.items())]


def answer(problem: Problem) -> Answer:
    """Fit, and draw from the posterior."""
    begun = time.process_time()
    found = fit(problem.model, problem.observations, free_of(problem), max_iterations=15)
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
    noise = [float(p[name].median()) if name in p else 0.0 for name in FREE[:2]]
    return Answer(
        lengths=np.stack(lengths),
        angles=problem.model.split(path)[1][..., 3:].numpy(),
        torques=path[..., 3:7].numpy(),
        points=torch.cat(points),
        noise=(noise[0], noise[1]),
        seconds=time.process_time() - begun,
    )


def reprojected(calibration: Calibration, points: torch.Tensor) -> torch.Tensor:
    """(N, C, T, P, 2)."""
    return project(pinhole(calibration), points.flatten(1, 2))[0].unflatten(2, points.shape[1:3])


def covered(found: Answer, views: Views, noise: tuple[float, float]) -> float:
    """Share of pixels of cameras that were left out within their 90 % intervals."""
    torch.manual_seed(1)
    expected = reprojected(views.calibration, found.points).movedim(1, 2)
    white, lasting = noise
    strays = torch.distributions.StudentT(4.0, 0.0, max(white, 1e-6)).sample(expected.shape)
    drawn = expected + strays + lasting * torch.randn_like(expected)
    low, high = (torch.quantile(drawn, q, dim=0).numpy() for q in (0.05, 0.95))
    known = np.isfinite(views.pixels)
    return float(((low <= views.pixels) & (views.pixels <= high))[known].mean())


def missed(found: Answer, views: Views) -> float:
    """Median distance of the posterior mean's projections from the pixels, px."""
    off = reprojected(views.calibration, found.points.mean(0, keepdim=True))[0].movedim(0, 1).numpy() - views.pixels
    return float(np.nanmedian(np.linalg.norm(off, axis=-1)))


def agreement(one: np.ndarray, other: np.ndarray) -> float:
    """Share of numbers of two answers that differ by less than 1.645 of both their standard deviations."""
    apart = np.abs(one.mean(0) - other.mean(0)) / np.hypot(one.std(0), other.std(0))
    return float((apart < 1.645).mean())


def row(subset: str, way: str, found: Answer, used: Views, rest: Views | None, noise: tuple[float, float]) -> str:
    lengths = zip(found.lengths.mean(0), found.lengths.std(0), strict=True)
    cells = [subset, way, *(f"{mean:.3f} ± {sd:.3f}" for mean, sd in lengths), f"{missed(found, used):.1f}"]
    cells += ["", ""] if rest is None else [f"{missed(found, rest):.1f}", f"{covered(found, rest, noise):.2f}"]
    cells.append(" ".join(f"{sd:.2f}" for sd in found.torques.std(0).mean(0)))
    return f"| {' | '.join([*cells, '{:.1f}, {:.1f}'.format(*noise), f'{found.seconds:.0f}'])} |"


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
    columns = "cameras | from | upper arm, m | forearm, m | used, px | left out, px | of it in 90 %"
    print(f"| {columns} | torques' sd, N·m | σ, β, px | CPU s |\n{'|---' * 10}|")
    for subset in given.subsets:
        used = [int(digit) - 1 for digit in subset]
        others = [c for c in range(len(calibration)) if c not in used]
        views = film(used, calibration, pixels, confidence, given.every)
        rest = film(others, calibration, pixels, confidence, given.every) if others else None
        recording = filmed(views)
        plain = Recording(recording.time, recording.keypoints, KEYPOINTS, recording.confidence)
        for way, each in (("pixels", recording), ("points", plain)):
            start = {**TORQUE, "initial.angle_scale": 1.0}
            own = answer(arm_problem(each, arm(), family="student_t", substeps=1, parameters=start))
            found[way][subset] = own
            noise = own.noise if way == "pixels" else (triangulate(views.calibration, *views.flat()).scale, 0.0)
            print(row(subset, way, own, views, rest, noise), flush=True)
    print(
        "\nShare that differs by less than 1.645 of both standard deviations: .90, and more where cameras are shared:\n"
    )
    print("| subsets | from | lengths apart, sd | angles | torques |\n|---|---|---|---|---|")
    for one, other in combinations(given.subsets, 2):
        for way, answers in found.items():
            a, b = answers[one], answers[other]
            z = np.abs(a.lengths.mean(0) - b.lengths.mean(0)) / np.hypot(a.lengths.std(0), b.lengths.std(0))
            shares = f"{agreement(a.angles, b.angles):.2f} | {agreement(a.torques, b.torques):.2f}"
            print(f"| {one}, {other} | {way} | {z[0]:.1f} {z[1]:.1f} | {shares} |")


if __name__ == "__main__":
    main()
