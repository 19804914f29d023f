"""Left and right exchanged, against walkers whose sides are known."""

import numpy as np
import pytest
from scenes import ring

from invdyn.recordings.cameras import Views, project, put_in_order, sides_kept
from invdyn.recordings.sides import exchanged, pairs_of

NAMES = ("L_hip", "nose", "R_hip", "R_wrist", "L_wrist")
ROWS = 60


def walker(seed=0, noise=2.0):
    """Two hips and two swinging wrists, half a metre apart, whose bearer turns past both cameras; and a nose."""
    time = np.arange(ROWS) / 30
    facing = 0.8 * time
    side = np.stack([-np.sin(facing), np.cos(facing), 0 * time], -1)
    ahead = np.stack([np.cos(facing), np.sin(facing), 0 * time], -1)
    swing = 0.3 * np.sin(6 * time)[:, None] * ahead
    up = np.array([0.0, 0.0, 1.0])
    points = [0.15 * side + up, 1.6 * up + 0 * side, -0.15 * side + up, -0.25 * side + up - swing]
    points = np.stack([*points, 0.25 * side + up + swing], 1)
    cameras = ring(2)
    rng = np.random.default_rng(seed)
    pixels = np.stack([project(camera, points) for camera in cameras], 1)
    pixels = pixels + noise * rng.standard_normal(pixels.shape)
    return Views(cameras, time, pixels, rng.uniform(size=pixels.shape[:3]), NAMES)


def wrong(views, rows, camera):
    """The same, sides exchanged in some rows of a camera."""
    pixels, confidence = views.pixels.copy(), views.confidence.copy()
    twin = [2, 1, 0, 4, 3]
    for each in (pixels, confidence):
        each[rows, camera] = each[rows, camera][:, twin]
    return Views(views.calibration, views.time, pixels, confidence, views.keypoint_names)


def test_pairs_are_found_by_name():
    assert pairs_of(NAMES) == [(0, 2), (3, 4)]
    assert pairs_of(("left wrist", "elbow", "right wrist")) == [(0, 2)]
    assert pairs_of(("wrist_r", "Wrist_L")) == [(0, 1)]
    assert pairs_of(("collar", "ulna", "left_hand", "upright")) == []


@pytest.mark.parametrize("seed", range(3))
def test_rows_that_were_exchanged_come_back(seed):
    right = walker(seed)
    rows = np.zeros(ROWS, bool)
    rows[[12, *range(20, 40), 45, 47, 59]] = True
    found, turned = sides_kept(wrong(right, rows, 1))
    np.testing.assert_array_equal(turned, np.stack([~np.ones(ROWS, bool), rows], 1))
    np.testing.assert_array_equal(found.pixels, right.pixels)
    np.testing.assert_array_equal(found.confidence, right.confidence)


def test_sides_that_pass_each_other_in_the_picture_stay():
    found, turned = sides_kept(walker(noise=0.5))
    assert not turned.any()
    across = found.pixels[:, :, 0, 0] - found.pixels[:, :, 2, 0]
    assert ((across.min(0) < 0) & (across.max(0) > 0)).any()  # or they never passed


def test_gaps_tell_nothing_and_single_sides_are_left_alone():
    views = walker()
    pixels = views.pixels[:, 0].copy()
    pixels[10:20] = np.nan
    assert not exchanged(pixels, [(0, 2), (3, 4)]).any()
    pixels[:, [0, 3]] = np.nan  # a twin that is never seen
    assert not exchanged(pixels, [(0, 2), (3, 4)]).any()
    assert not exchanged(pixels, []).any()
    assert not exchanged(np.full((5, 2, 2), np.nan), [(0, 1)]).any()


def test_what_was_put_back_is_said():
    right, rows = walker(), np.arange(ROWS) % 20 < 5
    with pytest.warns(UserWarning, match=f"camera .*left and right are exchanged in {rows.sum()} of {ROWS} rows"):
        found = put_in_order(wrong(right, rows, 1))
    np.testing.assert_array_equal(found.pixels, right.pixels)
    assert put_in_order(right) is not None  # and nothing where nothing was exchanged
