"""Points in space: exact without noise, as certain as they say with noise, unmoved by a camera that strays."""

import numpy as np
import pytest
from scenes import looking, ring, swinging

from invdyn.recordings import InputError
from invdyn.recordings.cameras.camera import Calibration
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.triangulate import triangulate

POINTS = swinging().reshape(-1, 3)


def pixels_of(calibration, points=POINTS):
    return np.stack([project(camera, points) for camera in calibration], 1)


@pytest.mark.parametrize("count", [2, 4])
def test_exact_without_noise(count):
    calibration = ring(count)
    found = triangulate(calibration, pixels_of(calibration), scale=1.0)
    np.testing.assert_allclose(found.points, POINTS, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(found.residuals)) < 1e-6


def test_as_opencv_does_with_two_cameras():
    """In two views the nearest point is theirs up to where they measure: rays for them, pixels for us."""
    cv2 = pytest.importorskip("cv2")
    from invdyn.recordings.cameras.projection import undistort

    calibration = ring(2)
    pixels = pixels_of(calibration)
    poses = [np.c_[camera.rotation, camera.translation] for camera in calibration]
    planes = [undistort(camera, pixels[:, c]).T for c, camera in enumerate(calibration)]
    theirs = cv2.triangulatePoints(*poses, *planes)
    np.testing.assert_allclose(
        triangulate(calibration, pixels, scale=1.0).points, (theirs[:3] / theirs[3]).T, rtol=0, atol=1e-9
    )


def test_the_covariance_is_that_of_the_errors():
    """Student-t pixels of σ 3: the squared error in its own covariance has the quantiles of a χ² with 3 degrees."""
    calibration, rng = ring(4), np.random.default_rng(0)
    points = np.tile(POINTS, (5, 1))
    clean = pixels_of(calibration, points)
    tails = np.sqrt(rng.chisquare(4, clean.shape[:2]) / 4)[..., None]
    found = triangulate(calibration, clean + 3 * rng.standard_normal(clean.shape) / tails)
    assert found.scale == pytest.approx(3, rel=0.1)
    error = found.points - points
    normal = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
    # Of 600 points 90 % below 6.25 is ± 1.2 %; weights of four pixels are less than all of the truth: 2 % are missing.
    assert np.mean(normal < 6.25) == pytest.approx(0.9, abs=0.04)
    assert np.mean(normal < 2.37) == pytest.approx(0.5, abs=0.05)


def test_a_camera_that_strays_does_not_drag_the_point_along():
    calibration, rng = ring(4), np.random.default_rng(1)
    pixels = pixels_of(calibration) + rng.standard_normal((len(POINTS), 4, 2))
    pixels[::3, 2] += [150, -80]
    found = triangulate(calibration, pixels)
    error = np.linalg.norm(found.points - POINTS, axis=-1)
    assert error[::3].max() < 0.02
    assert (found.weights[::3, 2] < 0.01).all()
    assert np.median(found.weights[1::3, 2]) > 0.8


def test_confidence_weighs():
    """A pixel without confidence is as good as none."""
    calibration, rng = ring(3), np.random.default_rng(2)
    pixels = pixels_of(calibration)
    pixels[:, 0] += rng.normal(0, 40, (len(POINTS), 2))
    trust = np.ones(pixels.shape[:2])
    trust[:, 0] = 0
    found = triangulate(calibration, pixels, trust, scale=1.0)
    np.testing.assert_allclose(found.points, POINTS, rtol=0, atol=1e-9)
    assert (found.weights[:, 0] == 0).all()


def test_a_point_that_one_camera_sees_has_no_place():
    calibration = ring(3)
    pixels = pixels_of(calibration)
    pixels[0, :2] = np.nan
    pixels[1, 0] = np.nan
    pixels[2] = np.nan
    found = triangulate(calibration, pixels, scale=1.0)
    assert np.isnan(found.points).all(-1).tolist()[:4] == [True, False, True, False]
    assert np.isnan(found.covariance).all((1, 2)).tolist()[:4] == [True, False, True, False]
    assert (found.weights[0] == 0).all()
    np.testing.assert_allclose(found.points[1], POINTS[1], rtol=0, atol=1e-9)


def test_a_point_behind_a_camera_is_found_by_the_others():
    calibration = ring(3)
    beyond = np.array([[5.0, 0.2, 1.2], [0.0, 0.0, 1.0]])  # cam1 stands at x = 3 and looks at the middle
    pixels = pixels_of(calibration, beyond)
    assert np.isnan(pixels[0, 0]).all()
    found = triangulate(calibration, pixels, scale=1.0)
    np.testing.assert_allclose(found.points, beyond, rtol=0, atol=1e-8)
    pixels[0, 0] = [600, 500]  # what it tracks must be something else
    found = triangulate(calibration, pixels, scale=1.0)
    np.testing.assert_allclose(found.points, beyond, rtol=0, atol=1e-8)
    assert np.isnan(found.residuals[0, 0]).all()


def test_lines_of_sight_that_are_nearly_one_give_no_depth():
    calibration = Calibration((looking("one", (3, 0, 1.0)), looking("two", (3, 0.001, 1.0))), metric=True)
    pixels = pixels_of(calibration)
    assert np.isnan(triangulate(calibration, pixels, scale=1.0).points).all()


def test_cameras_in_one_place_are_refused():
    calibration = Calibration((looking("one", (3, 0, 1.0)), looking("two", (3, 0, 1.0), focal=900.0)), metric=True)
    with pytest.raises(InputError, match="have the same position"):
        triangulate(calibration, pixels_of(calibration))


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_a_scale_must_be_one(scale):
    calibration = ring(2)
    with pytest.raises(InputError, match="scale of a pixel's error must be positive"):
        triangulate(calibration, pixels_of(calibration), scale=scale)


def test_nothing_in_common_is_refused():
    calibration = ring(2)
    pixels = pixels_of(calibration)
    pixels[::2, 0] = np.nan
    pixels[1::2, 1] = np.nan
    with pytest.raises(InputError, match="no point is seen by two cameras"):
        triangulate(calibration, pixels)
    with pytest.raises(InputError, match="two cameras or more"):
        triangulate(calibration.select(["cam1"]), pixels[:, :1])
    with pytest.raises(InputError, match="shape"):
        triangulate(calibration, pixels[:, :1])


def test_where_two_pairs_of_three_cameras_agree_the_covariance_holds_both_places():
    """One pixel of three strays in some rows: whichever pair is believed, the truth is within what is stated."""
    calibration = ring(4)
    calibration = Calibration(tuple(calibration)[:3], metric=True)
    points = swinging(200).reshape(-1, 3)
    beyond, strays = 0, 0
    for seed in range(5):
        rng = np.random.default_rng(seed)
        pixels = pixels_of(calibration, points) + rng.normal(size=(len(points), 3, 2))
        astray = rng.random(pixels.shape[:2]) < 0.02
        pixels[astray] += rng.normal(size=(astray.sum(), 2)) * 60
        found = triangulate(calibration, pixels)
        error = found.points - points
        normal = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error)
        alone = astray.sum(1) == 1
        strays += alone.sum()
        beyond += ((normal > 16) & (np.linalg.norm(error, axis=-1) > 0.05) & alone).sum()  # 16: 1 in 900 by chance
        assert np.mean(normal[~astray.any(1)] < 6.25) == pytest.approx(0.9, abs=0.04)
    assert strays > 150
    assert beyond <= 3  # 9 with the covariance of one place alone
