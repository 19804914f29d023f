"""A camera's clock, from the motion that a log has, too."""

from dataclasses import replace

import numpy as np
import pytest
from in_space import ARM as TURRET
from in_space import play
from robot_log import ARM, robot_log

from invdyn.diagnosis.problem.clocks import camera_clock
from invdyn.models import load_body
from invdyn.recordings import InputError
from invdyn.recordings.joined import merge_log_and_camera


def apart(both, ahead, begin, end):
    """The log of a recording alone, and its film from ``begin`` to ``end`` s, by a clock that runs ``ahead``."""
    seen = np.isfinite(both.keypoints).all((1, 2)) & (both.time >= begin) & (both.time < end)
    film = replace(both.at(seen), angles=None, torques=None, joint_names=(), name="film")
    log = replace(both, keypoints=both.keypoints[:, :0], keypoint_names=())
    return log, replace(film, time=film.time + ahead)


def test_it_is_found_to_a_fraction_of_a_frame():
    for seed in range(3):
        log, film = apart(robot_log(15, seed=seed), 12.3456, 4, 12)
        clock = camera_clock(log, film, ARM)
        assert abs(clock.seconds - 12.3456) < 4 * clock.sd
        assert clock.sd < 1e-3  # frames are 17 ms apart


def test_whatever_the_cameras_frame_and_stray_points():
    log, film = apart(robot_log(15), -3.21, 4, 12)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    seen = 0.7 * film.keypoints @ turn.T + [3.0, 1.0]
    seen[::7] += np.random.default_rng(0).normal(0, 0.5, seen[::7].shape)
    clock = camera_clock(log, replace(film, keypoints=seen), ARM)
    assert abs(clock.seconds + 3.21) < max(4 * clock.sd, 1e-3)


def test_in_space(tmp_path):
    (tmp_path / "arm.xml").write_text(TURRET)
    log, film = apart(play(TURRET, 5.0, cameras=0.002), 0.5, 1, 4)
    clock = camera_clock(log, film, load_body(tmp_path / "arm.xml"))
    assert abs(clock.seconds - 0.5) < max(4 * clock.sd, 1e-3)


@pytest.mark.long
def test_what_does_not_tell_is_refused():
    log, film = apart(robot_log(15), 0.0, 4, 12)
    rng = np.random.default_rng(0)
    other = replace(film, keypoints=rng.normal(0, 0.2, film.keypoints.shape))
    with pytest.raises(InputError, match="nothing in it moves as the log says"):
        camera_clock(log, other, ARM)
    with pytest.raises(InputError, match="with angles"):
        camera_clock(film, film, ARM)
    time = log.time
    swing = np.stack([np.sin(2 * np.pi * time), np.sin(2 * np.pi * time + 1)], -1)
    again = replace(log, angles=swing, torques=None)
    turned = swing.cumsum(1)
    tips = (np.array([0.3, 0.25])[:, None] * np.stack([np.cos(turned), np.sin(turned)], -1)).cumsum(1)
    part = (time >= 4) & (time < 12)
    with pytest.raises(InputError, match="the motion repeats: state --set clock"):
        camera_clock(again, replace(film, time=time[part], keypoints=tips[part]), ARM)


def test_merged():
    both = robot_log(5)
    log, film = apart(both, 7.0, 1, 4)
    one = merge_log_and_camera(log, film, 7.0)
    assert one.num_frames == log.num_frames  # each picture comes with a row
    part = (both.time >= 1) & (both.time < 4)
    np.testing.assert_array_equal(one.keypoints[part], both.keypoints[part])
    np.testing.assert_array_equal(one.angles, log.angles)
    np.testing.assert_array_equal(one.torques, log.torques)
    between = merge_log_and_camera(log, film, 7.0 + 0.0007)
    assert between.num_frames == log.num_frames + film.num_frames
    new = np.isnan(between.angles).all(1)
    np.testing.assert_array_equal(between.keypoints[new], film.keypoints)
    held = np.searchsorted(log.time, between.time[new], side="right") - 1
    np.testing.assert_array_equal(between.torques[new], log.torques[held])
    with pytest.raises(InputError, match="they share no time"):
        merge_log_and_camera(log, film, -20.0)
    with pytest.raises(InputError, match="without keypoints of its own"):
        merge_log_and_camera(both, film)
    with pytest.raises(InputError, match="expected keypoints to merge with a log"):
        merge_log_and_camera(log, log)
