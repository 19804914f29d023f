"""Two cameras that have each other's tracks, and scenes that are none."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scenes import ring, swinging

from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.scene import reconstruct
from invdyn.recordings.cameras.views import Views

NAMES = ("shoulder", "elbow", "wrist")


def filmed(count, noise=1.0, seed=0):
    cameras, points = ring(count), swinging(30)
    rng = np.random.default_rng(seed)
    pixels = np.stack([project(camera, points) for camera in cameras], 1)
    pixels += noise * rng.standard_normal(pixels.shape)
    return Views(cameras, np.arange(30) / 30, pixels, np.ones(pixels.shape[:-1]), NAMES)


def exchanged(views, one, other):
    order = list(range(len(views.calibration)))
    order[one], order[other] = other, one
    return replace(views, pixels=views.pixels[:, order])


@pytest.mark.quick("3-*", "4-0-3")
@pytest.mark.parametrize(
    ("count", "one", "other"), [(2, 0, 1), (3, 0, 1), (3, 0, 2), (3, 1, 2), (4, 0, 3), (4, 1, 2), (4, 1, 3)]
)
def test_the_two_cameras_are_named(count, one, other):
    with pytest.warns(UserWarning, match=f"if cam{one + 1} and cam{other + 1} have each other's tracks: exchange"):
        reconstruct(exchanged(filmed(count), one, other), name="arm")


@pytest.mark.quick("3-*", "2-*", "4-1.0")
@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_right_cameras_are_trusted_though_a_tracker_errs(count, noise):
    views = filmed(count, noise)
    views.pixels[4:9, 0, 1] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reconstruct(views)


@pytest.mark.long
def test_a_film_of_something_else_is_told():
    views = filmed(4)
    views.pixels[:] = np.random.default_rng(0).uniform(0, 900, views.pixels.shape)
    with pytest.warns(UserWarning, match="far beyond a tracker's errors: are files and cameras exchanged"):
        reconstruct(views)


def test_a_single_keypoint_has_no_extent_to_compare_with():
    views = exchanged(filmed(3), 0, 1).select(["wrist"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reconstruct(views)
