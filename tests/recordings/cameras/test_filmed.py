"""A film of several cameras is a recording of points, with its pixels beside them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from scenes import ring, swinging

from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras import Filmed, Views, filmed, project

NAMES = ("shoulder", "elbow", "wrist")
TIME = np.arange(20) / 20
POINTS = swinging(20)


@pytest.fixture
def views():
    calibration = ring(3)
    pixels = np.stack([project(camera, POINTS) for camera in calibration], 1)
    return Views(calibration, TIME, pixels, np.full(pixels.shape[:3], 0.9), NAMES)


def test_points_are_triangulated_and_pixels_kept(views):
    film = filmed(views, "arm")
    np.testing.assert_allclose(film.keypoints, POINTS, rtol=0, atol=1e-8)
    assert (film.name, film.keypoint_names) == ("arm", NAMES)
    assert film.views is views


def test_rows_are_taken_of_both(views):
    some = filmed(views).select(5, 12)
    assert isinstance(some, Filmed)
    np.testing.assert_array_equal(some.views.pixels, views.pixels[5:12])
    np.testing.assert_array_equal(some.views.time, some.time)
    np.testing.assert_allclose(some.keypoints, POINTS[5:12], rtol=0, atol=1e-8)
    with pytest.raises(InputError, match="at least 2 frames"):
        some.select(3, 4)


def test_keypoints_are_chosen_in_order(views):
    chosen = views.select(("wrist", "shoulder"))
    np.testing.assert_array_equal(chosen.pixels, views.pixels[:, :, [2, 0]])
    assert chosen.keypoint_names == ("wrist", "shoulder")


def test_what_does_not_fit_is_refused(views):
    film = filmed(views)
    with pytest.raises(InputError, match="leave --set base out"):
        film.relative_to("shoulder")
    with pytest.raises(InputError, match="--calibration-out"):
        filmed(replace(views, calibration=ring(3).scaled(2.0, metric=False)))
    own = {each.name: getattr(film, each.name) for each in fields(Recording)}
    with pytest.raises(InputError, match="views of the recording's own keypoints"):
        Filmed(**own)
    with pytest.raises(InputError, match="at the recording's own times"):
        Filmed(**own | {"time": TIME + 1}, views=views)
