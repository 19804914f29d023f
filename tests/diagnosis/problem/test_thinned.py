"""Long recordings in fewer rows."""

from dataclasses import replace

import numpy as np
from robot_log import robot_log

from invdyn.diagnosis.problem.stretches import left_out, thinned
from invdyn.diagnosis.rules import DEFAULT

ROWS = DEFAULT.recording.max_rows


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


def test_what_is_left_out_is_told():
    short, long = robot_log(0.5), robot_log(2.0)
    angles, torques = (np.tile(values, (3, 1)) for values in (long.angles, long.torques))
    keypoints, time = np.tile(long.keypoints, (3, 1, 1)), np.arange(3000) / 500
    long = replace(long, time=time, keypoints=keypoints, angles=angles, torques=torques)
    assert left_out([short]) is None
    assert left_out([short, long]).startswith(
        f"Of 3250 rows with an observation {250 + rows(thinned(long, ROWS))} were"
    )
    assert rows(thinned(long, ROWS)) <= ROWS


def rows(log):
    return int((np.isfinite(log.keypoints).any((1, 2)) | np.isfinite(log.angles).any(1)).sum())
