"""Recordings with one known mistake each: what is found, what is said, and what comes back."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from invdyn.recordings import Recording, load, write_keypoint_csv
from invdyn.recordings.repairs import repaired, unwrapped

TIME = np.arange(120) / 30
NAMES = ("shoulder", "elbow", "wrist")


def arm(place=(0.0, 1.4), phase=0.0, noise=0.003, seed=0):
    """Shoulder, elbow and wrist (T, 3, 2), m, of somebody who sways."""
    raised = -1.2 + 0.7 * np.sin(3.0 * TIME + phase)
    bent = raised + 0.9 + 0.5 * np.sin(4.5 * TIME + phase)
    steps = [[0.05 * np.sin(TIME), 0 * TIME]]
    steps += [[0.3 * np.cos(a), 0.3 * np.sin(a)] for a in (raised, bent)]
    points = np.asarray(place) + np.cumsum(np.moveaxis(np.array(steps), -1, 0), 1)
    return points + noise * np.random.default_rng(seed).standard_normal(points.shape)


def said(recording, **options):
    """The repaired recording, and what was said."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = repaired(recording, **options)
    return found, [str(each.message) for each in caught]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.02])
def test_a_right_recording_stays_as_it_is(seed, noise):
    sides = np.concatenate([arm(noise=noise, seed=seed), arm((0.35, 1.4), 2.0, noise, seed + 9)], 1)
    names = tuple(f"{side}_{name}" for side in ("left", "right") for name in NAMES)
    recording = Recording(TIME, sides, names, angles=np.cumsum(0.1 * np.ones((120, 2)), 0), joint_names=("a", "b"))
    found, lines = said(recording)
    assert not lines
    np.testing.assert_array_equal(found.keypoints, recording.keypoints)
    np.testing.assert_array_equal(found.angles, recording.angles)


@pytest.mark.parametrize("other", [(2.0, 1.2), (0.5, 1.4)])  # another person; the other arm
@pytest.mark.parametrize("rows", [slice(50, 70), slice(90, 120), slice(0, 20)])
def test_rows_of_another_person_are_missing(other, rows):
    points = arm()
    points[rows] = arm(other, 2.0, seed=1)[rows]
    found, (line,) = said(Recording(TIME, points, NAMES))
    lost = np.isnan(found.keypoints).all((1, 2))
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(120)[rows])
    assert f"in {lost.sum()} rows from row {rows.start + 1} ({TIME[rows.start]:.6g} s)" in line
    assert not said(found)[1]


def test_a_keypoint_that_is_wrong_for_itself_is_no_other_person():
    points = arm()
    points[40:45, 2] += 1.0
    assert not said(Recording(TIME, points, NAMES))[1]


def test_who_walks_fast_or_after_a_gap_is_the_same_person():
    points = arm() + np.array([3.0, 0.0]) * np.clip(TIME - 1.0, 0, None)[:, None, None]
    points[60:80] = np.nan
    assert not said(Recording(TIME, points, NAMES))[1]


def test_left_and_right_are_put_back_in_one_camera():
    sides = 200 * np.concatenate([arm(), arm((0.35, 1.4), 2.0, seed=1)], 1)
    names = tuple(f"{side}_{name}" for side in ("left", "right") for name in NAMES)
    rows = np.r_[30:55, 80:84]
    wrong = sides.copy()
    wrong[rows] = sides[rows][:, [3, 4, 5, 0, 1, 2]]
    found, (line,) = said(Recording(TIME, wrong, names, length_unit="px"))
    np.testing.assert_array_equal(found.keypoints, sides)
    assert "left and right are exchanged in 29 of 120 rows, first in row 31 (1 s)" in line


def turning():
    """Two joints (T, 2) rad: one turns by more than a revolution, the other swings."""
    return np.stack([0.5 + 2.5 * TIME, 0.8 * np.sin(4 * TIME)], -1)


@pytest.mark.parametrize("wrap", [lambda a: (a + np.pi) % (2 * np.pi) - np.pi, lambda a: a % (2 * np.pi)])
def test_wrapped_encoders_go_on(wrap):
    angles = turning()
    recording = Recording(TIME, np.empty((120, 0, 2)), (), angles=wrap(angles), joint_names=("shoulder", "elbow"))
    found, lines = said(recording)
    off = found.angles - angles
    np.testing.assert_allclose(off, np.broadcast_to(off[0], off.shape), atol=1e-12)
    assert all("is wrapped" in line and "first in row" in line for line in lines)
    assert "shoulder" in lines[0]
    assert not said(found)[1]


def test_one_reading_that_is_off_by_nearly_a_revolution_is_no_wrap():
    off = 0.1 * np.sin(np.arange(80) / 10)[:, None]
    off[30] += 5.5
    given = Recording(np.arange(80) / 50, np.empty((80, 0, 2)), (), angles=off, joint_names=("elbow",))
    np.testing.assert_array_equal(unwrapped(given).angles, off)


def test_a_slide_and_missing_rows_are_no_wrapped_encoder():
    angles = turning()
    shift = np.where(TIME > 2, 6.2, 0.0)
    angles[10:20] = np.nan
    both = np.stack([angles[:, 1], shift], -1)
    recording = Recording(TIME, np.empty((120, 0, 2)), (), angles=both, joint_names=("elbow", "rail"))
    found, lines = said(recording, shifting={"rail"})
    assert not lines
    np.testing.assert_array_equal(found.angles, both)


def test_files_are_repaired_where_they_are_read(tmp_path):
    points = arm()
    points[50:70] = arm((2.0, 1.2), 2.0, seed=1)[50:70]
    write_keypoint_csv(Recording(TIME, points, NAMES), tmp_path / "rec.csv")
    with pytest.warns(UserWarning, match=r"keypoints jump together, .* from row 51 \(1.66667 s\) to row 70"):
        found = load(tmp_path / "rec.csv")
    assert np.isnan(found.keypoints[50:70]).all()


def test_a_filter_of_several_repairs_keeps_confidence_in_step():
    points, confidence = arm(), np.random.default_rng(0).uniform(0.8, 1, (120, 3))
    points[50:70] = arm((2.0, 1.2), 2.0, seed=1)[50:70]
    recording = Recording(TIME, points, NAMES, confidence=confidence)
    found, _ = said(replace(recording, name="walk"))
    np.testing.assert_array_equal(np.isnan(found.confidence).all(1), np.isnan(found.keypoints).all((1, 2)))
