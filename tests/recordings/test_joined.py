"""Several recordings as one table."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn.recordings import InputError, Recording, joined


def recording(start=0.0, frames=5, names=("elbow",), torque=True, name="a"):
    time = start + 0.1 * np.arange(frames)
    points = np.arange(frames)[:, None, None] + np.zeros((frames, len(names), 2))
    torques = np.ones((frames, 1)) if torque else None
    return Recording(time, points, names, torques=torques, joint_names=("shoulder",) if torque else (), name=name)


def test_one_is_itself():
    only = recording()
    assert joined([only]) == (only, ())


def test_end_to_end():
    whole, starts = joined([recording(2.0), recording(70.0, 3, name="b"), recording(0.0, 4, name="c")])
    np.testing.assert_allclose(whole.time, 2.0 + 0.1 * np.arange(12))
    assert starts == (5, 8)
    assert whole.name == "a + b + c"
    np.testing.assert_array_equal(whole.keypoints[:, 0, 0], [0, 1, 2, 3, 4, 0, 1, 2, 0, 1, 2, 3])
    assert whole.torques.shape == (12, 1)


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (recording(names=("wrist",), name="b"), "keypoint_names"),
        (recording(name="b").scaled(100.0, "px"), "length_unit"),
        (replace(recording(name="b"), keypoints=np.zeros((5, 1, 3))), "of a have 2 coordinates, those of b 3"),
    ],
)
def test_those_that_do_not_agree(other, says):
    with pytest.raises(InputError, match=f"must agree.*{says}"):
        joined([recording(), other])


def test_torques_of_one_only():
    first = recording(torque=False)
    second = Recording(first.time, first.keypoints, first.keypoint_names, confidence=np.ones((5, 1)), name="b")
    with pytest.raises(InputError, match="only one has confidence"):
        joined([first, second])


def test_none_at_all():
    with pytest.raises(InputError, match="expected one recording or more"):
        joined([])
