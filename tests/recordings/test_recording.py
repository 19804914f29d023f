import numpy as np
import pytest

from invdyn.recordings import InputError, Recording


def arm(**changes) -> Recording:
    fields = {
        "time": [0.0, 0.1, 0.3, 0.35],
        "keypoints": np.arange(16.0).reshape(4, 2, 2),
        "keypoint_names": ("elbow", "wrist"),
        "confidence": np.full((4, 2), 0.5),
        "angles": np.zeros((4, 2)),
        "torques": np.ones((4, 2)),
        "joint_names": ("shoulder", "elbow"),
    }
    return Recording(**(fields | changes))


def test_describes_itself():
    recording = arm()
    assert recording.num_frames == 4
    assert recording.duration == pytest.approx(0.35)
    assert recording.frame_interval == pytest.approx(0.1)  # the median; the times are irregular on purpose
    np.testing.assert_array_equal(recording.keypoint("wrist"), recording.keypoints[:, 1])


def test_select_takes_every_array_along():
    part = arm().select(1, -1)
    assert part.num_frames == 2
    for field in ("time", "keypoints", "confidence", "angles", "torques"):
        np.testing.assert_array_equal(getattr(part, field), getattr(arm(), field)[1:-1])
    assert arm(confidence=None, angles=None).select(2).confidence is None


def test_relative_to_subtracts_frame_by_frame_and_spreads_what_is_missing():
    keypoints = arm().keypoints.copy()
    keypoints[2, 0] = np.nan
    moved = arm(keypoints=keypoints).relative_to("elbow")
    np.testing.assert_array_equal(moved.keypoint("elbow")[[0, 1, 3]], 0.0)
    np.testing.assert_array_equal(moved.keypoint("wrist")[[0, 1, 3]], 2.0)
    assert np.isnan(moved.keypoint("wrist")[2]).all()


def test_scaled_keeps_all_but_lengths():
    scaled = arm().scaled(0.5, "body length")
    np.testing.assert_array_equal(scaled.keypoints, arm().keypoints / 2)
    assert scaled.length_unit == "body length"
    np.testing.assert_array_equal(scaled.angles, arm().angles)


def test_later_changes_of_the_callers_array_do_not_reach_it():
    time = np.array([0.0, 1.0, 2.0, 3.0])
    recording = arm(time=time)
    time[0] = 9.0
    assert recording.time[0] == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"time": [0.0, 0.1, 0.1, 0.2]}, r"repeats at frame 2"),
        ({"time": [0.0, 0.2, 0.1, 0.3]}, r"backwards at frame 2"),
        ({"time": [0.0, np.nan, 0.2, 0.3]}, r"time is nan at frame 1"),
        ({"time": [0.0, 0.1, 0.2, np.inf]}, r"time is inf at frame 3"),
        ({"time": np.zeros((4, 1))}, r"shape \(T,\)"),
        ({"time": "now"}, "array of numbers"),
        ({"keypoints": np.zeros((4, 3, 2))}, "P = 2"),
        ({"keypoints": np.zeros((4, 2, 4))}, r"\(T, P, 2\)"),
        ({"keypoints": np.full((4, 2, 2), np.inf)}, "keypoints is infinite at frame 0"),
        ({"torques": np.full((4, 2), -np.inf)}, "torques is infinite"),
        ({"keypoints": np.full((4, 2, 2), 1e8)}, r"keypoints is 1e\+08 at frame 0: expected numbers up to 1e\+07"),
        ({"time": [0.0, 1e-9, 0.1, 0.2]}, "advances by 1e-09 s at frame 1"),
        ({"time": [0.0, 0.1, 0.2, 1e300]}, r"time is 1e\+300 at frame 3"),
        ({"keypoints": np.full((4, 2, 2), np.nan), "angles": None}, "nothing is observed"),
        ({"confidence": np.zeros(4)}, "confidence must have shape"),
        ({"angles": np.zeros((4, 3))}, "angles must have shape"),
        ({"keypoint_names": ("elbow", "elbow")}, "name twice"),
    ],
)
def test_refuses_what_cannot_be_a_recording(changes, words):
    with pytest.raises(InputError, match=words):
        arm(**changes)


def test_refuses_a_single_frame():
    with pytest.raises(InputError, match="at least 2 frames, this one has 1"):
        arm().select(0, 1)


def test_refuses_unknown_keypoints_and_scales():
    with pytest.raises(InputError, match="no keypoint 'hand'; the recording has elbow, wrist"):
        arm().keypoint("hand")
    with pytest.raises(InputError, match="positive"):
        arm().scaled(0.0, "m")
