import numpy as np
import pytest

from invdyn.recordings import InputError, Recording, Truth, keypoints_from_angles


def swing(T: int = 1001, seconds: float = 2.0) -> Truth:
    time = np.linspace(0.0, seconds, T)
    angle = np.stack([np.sin(3 * time) - np.pi / 2, 0.5 * np.cos(2 * time)], axis=-1)
    return Truth(time, angle, np.zeros_like(angle), np.zeros_like(angle), ("shoulder", "elbow"))


def test_a_hanging_chain_and_a_bent_one():
    angle = np.array([[-np.pi / 2, 0.0], [0.0, np.pi / 2]])
    truth = Truth([0.0, 1.0], angle, 0 * angle, 0 * angle, ("shoulder", "elbow"))
    recording = keypoints_from_angles(truth, (0.3, 0.2), base=(1.0, 2.0))
    np.testing.assert_allclose(recording.keypoints[0], [[1, 1.7], [1, 1.5]], atol=1e-15)
    np.testing.assert_allclose(recording.keypoints[1], [[1.3, 2], [1.3, 2.2]], atol=1e-15)
    assert recording.keypoint_names == ("elbow", "wrist")
    assert recording.angles is None  # what made the keypoints must not leak
    assert recording.torques is None


def test_resampling_and_noise():
    exact = keypoints_from_angles(swing(), (0.3, 0.2), rate=60.0)
    assert exact.num_frames == 121  # both ends
    np.testing.assert_allclose(np.diff(exact.time), 1 / 60)
    # linear interpolation errs by at most h²/8 · max|θ̈| of each angle
    at_frames = Truth(exact.time, *(np.zeros((121, 2)) for _ in range(3)), ("shoulder", "elbow"))
    angle = np.stack([np.sin(3 * exact.time) - np.pi / 2, 0.5 * np.cos(2 * exact.time)], axis=-1)
    truth = Truth(exact.time, angle, at_frames.velocity, at_frames.torque, at_frames.joint_names)
    np.testing.assert_allclose(
        exact.keypoints, keypoints_from_angles(truth, (0.3, 0.2)).keypoints, atol=0.002**2 / 8 * 9
    )
    noisy = keypoints_from_angles(swing(), (0.3, 0.2), noise_sd=0.003, rate=60.0, seed=4)
    error = noisy.keypoints - exact.keypoints
    n = error.size  # the sd of a sample sd is about sd/√(2n)
    assert abs(error.std() - 0.003) < 4 * 0.003 / np.sqrt(2 * n)
    again = keypoints_from_angles(swing(), (0.3, 0.2), noise_sd=0.003, rate=60.0, seed=4)
    np.testing.assert_array_equal(noisy.keypoints, again.keypoints)
    other = keypoints_from_angles(swing(), (0.3, 0.2), noise_sd=0.003, rate=60.0, seed=5)
    assert not np.array_equal(noisy.keypoints, other.keypoints)


def test_missing_angles_stay_missing():
    angles = swing(5).angle.copy()
    angles[2, 1] = np.nan
    source = Recording(swing(5).time, np.empty((5, 0, 2)), (), angles=angles, joint_names=("shoulder", "elbow"))
    recording = keypoints_from_angles(source, (0.3, 0.2))
    assert np.isnan(recording.keypoint("wrist")[2]).all()
    assert np.isfinite(recording.keypoint("elbow")).all()


def test_refuses_what_does_not_fit():
    with pytest.raises(InputError, match="2 joint angles need as many link lengths, got 1"):
        keypoints_from_angles(swing(), (0.3,))
    with pytest.raises(InputError, match="rate positive"):
        keypoints_from_angles(swing(), (0.3, 0.2), rate=0)
    with pytest.raises(InputError, match="no joint angles"):
        keypoints_from_angles(Recording([0.0, 1.0], np.zeros((2, 1, 2)), ("wrist",)), (0.3,))
