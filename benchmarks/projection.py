"""Projection and pixel likelihood: points a second, for one thread of torch, and numpy's and OpenCV's projection.

A state is P keypoints in space, seen by C cameras with Brown's distortion; N states at once, as many as particles. A
pass is projection and likelihood with a bias; `gradient` is that pass and its derivatives by the points.

    python benchmarks/projection.py [--points 8] [--cameras 4] [--states 1 100 10000] [--dtype float64]
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from invdyn.inference.posterior.cameras import pinhole
from invdyn.models import Observation, Pixels
from invdyn.models.observation.pinhole import project
from invdyn.models.observation.view import View
from invdyn.recordings.cameras import Calibration, projection
from invdyn.recordings.cameras.camera import Camera

SECONDS = 0.5


def cameras_around(count: int) -> list[Camera]:
    """Cameras on a circle of 3 m that look at its middle."""
    cameras = []
    for number in range(count):
        angle = 2 * np.pi * number / count
        ahead = -np.array([np.cos(angle), np.sin(angle), 0.0])
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        matrix = [[1100.0, 0, 640], [0, 1100.0, 480], [0, 0, 1]]
        lens = [-0.12, 0.05, 0.001, -0.0006, 0.0]
        cameras.append(Camera(f"camera {number}", matrix, lens, rotation, 3 * rotation @ ahead, (1280, 960)))
    return cameras


def seconds(run: Callable[[], object]) -> float:
    """CPU seconds of a call: the least of as many as fit into half a second, three at least."""
    run()
    best, spent, times = np.inf, 0.0, 0
    while spent < SECONDS or times < 3:
        start = time.process_time()
        run()
        took = time.process_time() - start
        best, spent, times = min(best, max(took, 1e-9)), spent + took, times + 1
    return best


def passes(cameras: list[Camera], states: int, points: int, dtype: torch.dtype) -> dict[str, Callable[[], object]]:
    torch.manual_seed(0)
    names, size = tuple(camera.name for camera in cameras), torch.tensor([[1280.0, 960.0]] * len(cameras))
    pinholes = pinhole(Calibration(tuple(cameras), metric=True))
    sensor = Pixels(pinholes, names, size, tuple(range(points)))
    observation = Observation(sensor, family="student_t")
    parameters = {name: value.to(dtype) for name, value in observation.defaults(1.0).items()}
    cams = pinholes.to("cpu", dtype)
    where = (0.3 * torch.randn(states, points, 3)).to(dtype)
    pixels = project(cams, where[0])[0].flatten() + torch.randn(sensor.states, dtype=dtype)
    bias = torch.zeros(states, sensor.states, dtype=dtype)
    free = where.clone().requires_grad_()
    nothing: Any = None

    def likelihood(at: torch.Tensor) -> torch.Tensor:
        view = View(nothing, nothing, at, nothing, nothing, nothing, nothing, nothing, nothing, nothing, memory=bias)
        return observation.predict(view, 0, parameters).log_prob(pixels)

    def gradient() -> torch.Tensor:
        return torch.autograd.grad(likelihood(free).sum(), free)[0]

    plain = where.double().numpy()
    runs = {
        "project": lambda: project(cams, where),
        "likelihood": lambda: likelihood(where),
        "gradient": gradient,
        "numpy, project": lambda: [projection.project(camera, plain) for camera in cameras],
    }
    try:
        import cv2
    except ImportError:
        return runs
    cv2.setNumThreads(1)
    flat, turns = plain.reshape(-1, 3), [cv2.Rodrigues(camera.rotation)[0] for camera in cameras]
    runs["OpenCV, project"] = lambda: [
        cv2.projectPoints(flat, turn, camera.translation, camera.matrix, camera.distortion)
        for turn, camera in zip(turns, cameras, strict=True)
    ]
    return runs


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=8)
    parser.add_argument("--cameras", type=int, default=4)
    parser.add_argument("--states", type=int, nargs="+", default=[1, 100, 10_000])
    parser.add_argument("--dtype", choices=("float64", "float32"), default="float64")
    given = parser.parse_args()
    torch.set_num_threads(1)
    cameras = cameras_around(given.cameras)
    print(
        f"{given.cameras} cameras, {given.points} points a state, {given.dtype} (numpy and OpenCV: float64), 1 thread\n"
    )
    print("| states at once | pass | CPU ms | M pixels/s |\n|---|---|---|---|")
    for states in given.states:
        for name, run in passes(cameras, states, given.points, getattr(torch, given.dtype)).items():
            took = seconds(run)
            rate = states * given.points * given.cameras / took / 1e6
            print(f"| {states} | {name} | {1e3 * took:.3f} | {rate:.2f} |", flush=True)


if __name__ == "__main__":
    main()
