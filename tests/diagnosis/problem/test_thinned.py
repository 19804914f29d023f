"""Long recordings in fewer rows."""

import numpy as np
from robot_log import robot_log

from invdyn.diagnosis.problem.thinned import thinned


def test_a_short_recording_is_itself():
    log = robot_log(0.5)
    assert thinned(log, 250) is log


def test_each_stream_stays_even_and_commands_stay():
    log = robot_log(2.0)
    fewer = thinned(log, 400)
    streams = (fewer.keypoints, fewer.angles)
    frames, encoders = (np.flatnonzero(np.isfinite(values).reshape(1000, -1).any(1)) for values in streams)
    assert len(np.union1d(frames, encoders)) <= 400
    assert len(frames) == 120  # the camera has few, and keeps them
    assert set(np.diff(encoders)) == {4}
    np.testing.assert_array_equal(fewer.angles[encoders], log.angles[encoders])
    np.testing.assert_array_equal(fewer.torques, log.torques)


def test_a_camera_alone_is_thinned_too():
    log = robot_log(2.0)
    alone = thinned(log, 30)
    rows = np.isfinite(alone.keypoints).all((1, 2)) | np.isfinite(alone.angles).all(1)
    assert 20 < rows.sum() <= 30
