"""Poses that were moved are found again, lenses stay unless asked for, scale and first camera are held."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import moved, ring, swinging

from invdyn.recordings import InputError
from invdyn.recordings.cameras.bundle import BundleProblem, bundle_adjust
from invdyn.recordings.cameras.camera import Calibration
from invdyn.recordings.cameras.projection import project

TRUE = ring(4)
POINTS = swinging().reshape(-1, 3) * [2, 2, 1]
PIXELS = np.stack([project(camera, POINTS) for camera in TRUE], 1)


def to_the_scale_of(calibration, points, start):
    """The truth as far as pixels tell it: scaled about the first camera to the start's longest distance from it."""
    origin = start.cameras[0].position
    distance = [np.linalg.norm(camera.position - origin) for camera in start]
    far = int(np.argmax(distance))
    factor = distance[far] / np.linalg.norm(calibration.cameras[far].position - origin)
    return factor, origin + factor * (points - origin)


def test_exact_pixels_give_the_poses_back():
    start = moved(TRUE)
    found = bundle_adjust(start, PIXELS)
    assert found.converged
    assert found.before > 3
    assert found.after < 1e-5
    factor, points = to_the_scale_of(TRUE, POINTS, start)
    np.testing.assert_allclose(found.points, points, rtol=0, atol=1e-6)
    origin = TRUE.cameras[0].position
    for camera, true, first in zip(found.calibration, TRUE, start, strict=True):
        np.testing.assert_allclose(camera.position, origin + factor * (true.position - origin), rtol=0, atol=1e-6)
        np.testing.assert_allclose(camera.rotation, true.rotation, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(camera.matrix, first.matrix)
        np.testing.assert_array_equal(camera.distortion, first.distortion)
    np.testing.assert_array_equal(found.calibration.cameras[0].rotation, start.cameras[0].rotation)
    assert found.calibration.metric


def test_strays_and_gaps_are_borne():
    rng = np.random.default_rng(3)
    pixels = PIXELS + rng.standard_normal(PIXELS.shape)
    pixels[rng.random(pixels.shape[:2]) < 0.05] += 200
    pixels[rng.random(pixels.shape[:2]) < 0.1] = np.nan
    start = moved(TRUE, 1)
    found = bundle_adjust(start, pixels)
    _, points = to_the_scale_of(TRUE, POINTS, start)
    # 1 px at 3 m and 1100 px of focal length is 3 mm a ray.
    assert np.nanmedian(np.linalg.norm(found.points - points, axis=-1)) < 0.005
    assert found.after < 1.5


def test_a_focal_length_moves_only_if_asked():
    wrong = TRUE.cameras[1].matrix.copy()
    wrong[[0, 1], [0, 1]] *= 1.05
    pixels = PIXELS[::2]
    start = Calibration(tuple(replace(c, matrix=wrong) if c.name == "cam2" else c for c in TRUE), metric=True)
    fixed = bundle_adjust(start, pixels)
    np.testing.assert_array_equal(fixed.calibration.cameras[1].matrix, wrong)
    free = bundle_adjust(start, pixels, intrinsics=("focal", "distortion"))
    # Nearer and with a shorter lens looks almost the same: what is left is small, but not nothing.
    assert fixed.after > 20 * free.after
    ratio = free.calibration.cameras[1].focal / TRUE.cameras[1].focal
    np.testing.assert_allclose(ratio, 1, atol=2e-3)


def test_the_jacobian_is_that_of_differences():
    problem = BundleProblem(TRUE, PIXELS[:3], np.ones((3, 4)), 2.0, ("focal", "distortion"))
    rng = np.random.default_rng(4)
    vector = problem.pack(POINTS[:3])
    vector[: problem.camera_size] = rng.normal(0, 0.05, problem.camera_size)
    root = rng.uniform(0.5, 1, (4, 3))

    def weighted(v):
        return (root[..., None] * problem.pixel_errors(v)).ravel()

    exact = problem.jacobian(vector, root).toarray()
    for k, step in enumerate(1e-6 * np.eye(len(vector))):
        slope = (weighted(vector + step) - weighted(vector - step)) / 2e-6
        np.testing.assert_allclose(exact[:, k], slope, rtol=1e-5, atol=1e-4)


def test_what_cannot_be_adjusted_is_told():
    with pytest.raises(InputError, match="unknown part of a lens 'skew'"):
        bundle_adjust(TRUE, PIXELS, intrinsics=("skew",))
    pixels = PIXELS.copy()
    pixels[5:, 3] = np.nan
    with pytest.raises(InputError, match="'cam4' shares 5 points"):
        bundle_adjust(TRUE, pixels)
