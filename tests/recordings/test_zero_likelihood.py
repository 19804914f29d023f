import warnings

import numpy as np
import pytest

from invdyn.recordings import InputError, Recording
from invdyn.recordings.zero_likelihood import without_zeros

TIME = np.arange(40) / 40


def tracks(confidence=None):
    rng = np.random.default_rng(2)
    points = rng.uniform(100, 300, (40, 2, 2))
    return Recording(TIME, points, ("knee", "heel"), confidence=confidence)


def sure():
    return np.random.default_rng(3).uniform(0.9, 1.0, (40, 2))


def test_a_likelihood_of_0_is_missing_wherever_the_point_lies():
    confidence = sure()
    confidence[5:9, 1] = 0.0
    recording = without_zeros(tracks(confidence), pixels=False)
    lost = np.isnan(recording.keypoints).all(axis=-1)
    np.testing.assert_array_equal(lost, confidence == 0)
    np.testing.assert_array_equal(recording.keypoints[~lost], tracks().keypoints[~lost])


def test_a_likelihood_that_is_0_throughout_says_nothing():
    recording = without_zeros(tracks(np.zeros((40, 2))), pixels=True)
    assert recording.confidence is None
    assert np.isfinite(recording.keypoints).all()
    one = sure()
    one[:, 0] = 0.0
    with pytest.raises(InputError, match="'knee' is missing in every frame"):
        without_zeros(tracks(one), pixels=True)


def test_the_corner_of_an_image_is_missing_and_told():
    recording = tracks()
    points = recording.keypoints.copy()
    points[10:17, 0] = 0.0
    recording = Recording(TIME, points, recording.keypoint_names)
    with pytest.warns(UserWarning, match=r"knee is at the image's corner \(0, 0\) in 7 of 40 rows"):
        cleaned = without_zeros(recording, pixels=True)
    np.testing.assert_array_equal(np.isnan(cleaned.keypoints[:, 0, 0]), points[:, 0, 0] == 0)
    points[:, 0] = 0.0  # the origin of the tracks, not a lost point
    relative = Recording(TIME, points, recording.keypoint_names)
    np.testing.assert_array_equal(without_zeros(relative, pixels=True).keypoints, points)


def with_repeats(low, rows, digits):
    """A heel that is written again in some rows, at some likelihood; tracks with noise, to so many digits."""
    confidence = sure()
    confidence[20 : 20 + rows, 1] = low
    if rows == 20:
        confidence[:, 1] = low  # in every frame
    points = 150 + 40 * np.sin(6 * TIME)[:, None, None] * [[1.0, 0.5], [0.4, 1.0]]
    points = np.round(points + np.random.default_rng(2).normal(0, 0.3, points.shape), digits)
    points[20 : 20 + rows, 1] = points[20, 1]
    return Recording(TIME, points, ("knee", "heel"), confidence=confidence)


@pytest.mark.parametrize("low", [0.1, 0.95, np.nan])
def test_a_place_that_noise_could_not_repeat_is_missing_and_told(low):
    recording = with_repeats(low, 5, 6)
    with pytest.warns(UserWarning, match=r"heel stands still to the last digit in 4 rows, first from row 22 to 25"):
        kept = without_zeros(recording, pixels=True)
    lost = np.isnan(kept.keypoints).all(-1)
    np.testing.assert_array_equal(np.argwhere(lost), [[row, 1] for row in range(21, 25)])
    np.testing.assert_array_equal(kept.keypoints[~lost], recording.keypoints[~lost])


def test_a_marker_without_confidence_that_is_written_again_is_missing():
    recording = Recording(TIME, with_repeats(0.9, 5, 6).keypoints, ("knee", "heel"))
    with pytest.warns(UserWarning, match="heel stands still"):
        assert np.isnan(without_zeros(recording, pixels=False).keypoints[21:25, 1]).all()


@pytest.mark.parametrize(
    ("low", "rows", "told"),
    [(0.1, 5, True), (0.95, 5, False), (0.1, 2, False), (np.nan, 5, False), (np.nan, 20, False)],
)
def test_a_place_in_whole_pixels_that_is_kept_at_a_low_likelihood_is_told(low, rows, told):
    recording = with_repeats(low, rows, 0)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        kept = without_zeros(recording, pixels=True)
    np.testing.assert_array_equal(kept.keypoints, recording.keypoints)
    said = [str(each.message) for each in caught]
    assert len(said) == told
    assert all("heel stands still to the last digit in " in each and "leave these cells empty" in each for each in said)


def test_a_place_that_is_written_again_to_the_end_is_missing_however_long():
    recording = with_repeats(0.9, len(TIME) - 20, 6)
    with pytest.warns(
        UserWarning, match=f"heel stands still to the last digit in {len(TIME) - 21} rows, first from row 22"
    ):
        kept = without_zeros(recording, pixels=True).keypoints
    np.testing.assert_array_equal(np.isnan(kept).all(-1).sum(0), [0, len(TIME) - 21])


def test_an_arm_at_rest_without_noise_is_there():
    points = 0.3 + 0.2 * np.tile(np.clip(TIME - 0.4, 0, None)[:, None, None] ** 3, (1, 2, 2))
    recording = Recording(TIME, points, ("knee", "heel"))
    np.testing.assert_array_equal(without_zeros(recording, pixels=False).keypoints, points)


@pytest.mark.parametrize("value", [-1.0, 0.0, 999.0])
@pytest.mark.parametrize("pixels", [True, False])
def test_a_number_that_stands_for_missing_is_missing(value, pixels):
    points = with_repeats(0.9, 1, 6).keypoints * (1.0 if pixels else 0.01) + 0.0
    points[[3, 7, 8], 0] = value
    with pytest.warns(UserWarning, match=rf"knee is at .*\({value:g}, {value:g}\) in 3 of 40 rows: taken"):
        kept = without_zeros(Recording(TIME, points, ("knee", "heel")), pixels=pixels).keypoints
    assert np.isnan(kept[[3, 7, 8], 0]).all()
    assert np.isfinite(kept).sum() == points.size - 6


def metric(zeros=(10, 17), offset=(0.4, 1.2, 0.1)):
    """A marker that moves by 2 cm a row along x from ``offset``, m, and is written as 0 0 0 in some rows."""
    track = np.tile(offset, (40, 1, 1)) + 0.02 * np.arange(40)[:, None, None] * [1.0, 0.0, 0.0]
    track[slice(*zeros)] = 0.0
    return Recording(TIME, track, ("wrist",))


def test_a_marker_at_0_0_0_is_missing_where_no_step_leads_there():
    recording = metric()
    with pytest.warns(UserWarning, match=r"wrist is at the origin \(0, 0, 0\) in 7 of 40 rows: taken to be missing"):
        cleaned = without_zeros(recording, pixels=False)
    lost = np.isnan(cleaned.keypoints[:, 0]).all(axis=-1)
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(10, 17))
    np.testing.assert_array_equal(cleaned.keypoints[~lost], recording.keypoints[~lost])


@pytest.mark.parametrize(
    ("zeros", "offset"),
    [
        ((10, 11), (-0.2, 0.0, 0.0)),  # it moves through the origin
        ((0, 5), (-0.1, 0.0, 0.0)),  # it starts there, and moves on
        ((0, 40), (0.4, 1.2, 0.1)),  # it is the origin
    ],
)
def test_a_marker_that_moves_to_the_origin_is_there(zeros, offset):
    recording = metric(zeros, offset)
    np.testing.assert_array_equal(without_zeros(recording, pixels=False).keypoints, recording.keypoints)


def test_rows_of_commands_between_do_not_hide_the_steps():
    recording = metric((0, 4), (-0.07, 0.0, 0.0))
    points = np.full((80, 1, 3), np.nan)
    points[::2] = recording.keypoints
    between = Recording(np.arange(80) / 80, points, ("wrist",))
    np.testing.assert_array_equal(without_zeros(between, pixels=False).keypoints, points)
