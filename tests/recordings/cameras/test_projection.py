"""Projection against OpenCV, its derivatives against differences, its inverse against itself."""

import numpy as np
import pytest
from scenes import looking

from invdyn.recordings.cameras.projection import Lens, project, project_with_jacobian, rays, undistort, valid_radius

cv2 = pytest.importorskip("cv2")

LENSES = {
    "none": ((0, 0, 0, 0, 0), False),
    "Brown": ((-0.3, 0.12, 0.002, -0.001, -0.02), False),
    "cushion": ((0.2, 0.1, -0.003, 0.002, 0.05), False),
    "fisheye": ((0.03, -0.01, 0.004, -0.001), True),
}


def camera_and_points(lens, many=200):
    coefficients, fisheye = LENSES[lens]
    camera = looking("one", (3.0, 1.0, 1.5), distortion=coefficients, fisheye=fisheye)
    points = np.random.default_rng(0).normal((0, 0, 1), 0.4, (many, 3))
    return camera, points


@pytest.mark.parametrize("lens", LENSES)
def test_the_same_as_opencv(lens):
    camera, points = camera_and_points(lens)
    turn, _ = cv2.Rodrigues(camera.rotation)
    theirs = cv2.fisheye.projectPoints if camera.fisheye else cv2.projectPoints
    given = points[:, None] if camera.fisheye else points
    order = (turn, camera.translation, camera.matrix, camera.distortion)
    expected, _ = theirs(given, *order)
    # Coordinates near 1000 px: 1e-10 is some hundred roundings; their rotation went through a vector and back.
    np.testing.assert_allclose(project(camera, points), expected.reshape(-1, 2), rtol=0, atol=1e-10)


@pytest.mark.parametrize("lens", LENSES)
def test_derivatives_are_those_of_differences(lens):
    camera, points = camera_and_points(lens, 20)
    _, jacobian, _ = project_with_jacobian(camera, points)
    step = 1e-6
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        slope = (project(camera, points + shift) - project(camera, points - shift)) / (2 * step)
        # Rounding of 1000 px over 1e-6 m: 1e-7 px/m at 1000 px/m.
        np.testing.assert_allclose((jacobian @ camera.rotation)[..., axis], slope, rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("lens", LENSES)
def test_rays_lead_back_to_the_points(lens):
    camera, points = camera_and_points(lens)
    aim = rays(camera, project(camera, points))
    towards = points - camera.position
    np.testing.assert_allclose(aim, towards / np.linalg.norm(towards, axis=-1, keepdims=True), rtol=0, atol=1e-13)


def test_undistorted_as_opencv_does():
    camera, _ = camera_and_points("Brown")
    pixels = np.random.default_rng(1).uniform((200, 150), (1000, 800), (100, 2))
    strict = (cv2.TERM_CRITERIA_MAX_ITER | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    theirs = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion, criteria=strict)[:, 0]
    np.testing.assert_allclose(undistort(camera, pixels), theirs, rtol=0, atol=1e-12)


def test_a_point_behind_the_camera_has_no_pixel():
    camera = looking("one", (3.0, 0.0, 1.0))
    ahead, behind, beside = np.array([0, 0, 1.0]), np.array([6.0, 0, 1.0]), camera.position
    pixels, jacobian, _ = project_with_jacobian(camera, np.stack([ahead, behind, beside]))
    assert np.isfinite(pixels).all(-1).tolist() == [True, False, False]
    assert np.isfinite(jacobian).all((-2, -1)).tolist() == [True, False, False]


def test_past_its_limit_a_lens_has_no_pixel_and_no_ray():
    strong = (-0.3, 0.0, 0.0, 0.0, 0.0)
    limit = valid_radius(np.array(strong), False)
    assert limit == pytest.approx((1 / 0.9) ** 0.5)  # 1 − 3 · .3 r² = 0
    camera = looking("one", (1.0, 0.0, 1.0), distortion=strong, focal=400.0)
    side = np.array([[0.0, 0.9 * limit, 1.0], [0.0, 1.1 * limit, 1.0]])
    assert np.isfinite(project(camera, side)).all(-1).tolist() == [True, False]
    highest = limit * (1 - 0.3 * limit**2)
    lens = Lens.of(camera)
    rising = lens.undistort(np.array([[0.99 * highest, 0.0], [1.01 * highest, 0.0]]))
    assert np.isfinite(rising).all(-1).tolist() == [True, False]
    # The root past the limit also fits the pixel; the one before it is the ray.
    assert rising[0, 0] < limit


def test_a_mild_lens_has_no_limit():
    assert valid_radius(np.array([0.1, 0.02, 0.0, 0.0, 0.0]), False) == np.inf
    assert valid_radius(np.zeros(4), True) == np.inf
