import hashlib
import re

import numpy as np
import pytest

from invdyn.recordings import (
    InputError,
    in_body_lengths,
    load,
    load_truth,
    median_link_lengths,
    names,
)
from invdyn.recordings.catalogue import CATALOGUE


def test_every_source_is_pinned():
    assert len(names()) == 33
    for name, entry in CATALOGUE.items():
        for source in entry.sources:
            assert source.rounded == (entry.read.__name__ == "read_dfki"), name
            if name == "dfki-film":
                assert not source.repository
            else:
                assert re.fullmatch("[0-9a-f]{40}", source.commit), name
                assert re.fullmatch("[0-9a-f]{64}", source.sha256), name
                assert source.url.startswith("https://raw.githubusercontent.com/")


@pytest.mark.parametrize("name", names())
def test_every_recording_loads_and_has_the_pinned_hash(data_folder, name):
    recording = load(name)
    assert recording.name == name
    assert recording.num_frames > 100
    for source in CATALOGUE[name].sources:
        if source.repository:
            content = (data_folder / source.file).read_bytes()
            assert hashlib.sha256(content).hexdigest() == source.sha256


def test_human_arm(data_folder):
    recording = load("human-arm")
    assert (recording.num_frames, recording.length_unit) == (444, "px")
    assert recording.keypoint_names == ("shoulder", "elbow", "wrist")
    assert recording.frame_interval == pytest.approx(1 / 30)
    about = load("human-arm", keypoints=("elbow", "wrist"), base="shoulder")
    np.testing.assert_allclose(about.keypoints, recording.keypoints - np.nanmedian(recording.keypoints[:, 0], 0))
    assert median_link_lengths(in_body_lengths(recording)).sum() == pytest.approx(1.0)


def test_the_robots_angles_point_where_its_film_shows(data_folder):
    """Encoders (hanging, relative, counter-clockwise) against pixels: the camera errs by about 1 cm."""
    film, truth = load("dfki-film"), load_truth("dfki-film")
    assert film.duration == pytest.approx(5.0, abs=0.1)
    assert film.angles is None
    assert film.torques is None
    heading = np.cumsum(truth.angle, axis=1)
    links = np.array([[0.3], [0.22]]) * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    error = film.keypoints - np.cumsum(links, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.012
    np.testing.assert_allclose(median_link_lengths(film), 0.22, rtol=0.03)


def test_the_film_and_the_log_are_one_event(data_folder):
    log, film = load_truth("dfki-swing-up").at(load("dfki-film").time), load_truth("dfki-film")
    np.testing.assert_allclose(log.angle, film.angle, atol=1e-3)
    correlation = np.corrcoef(log.torque[:, 0], film.torque[:, 0])[0, 1]
    assert correlation > 0.9  # a frame's mean against the moment's value


def test_robot_logs(data_folder):
    recording, truth = load("dfki-trajectory-00"), load_truth("dfki-trajectory-00")
    assert recording.joint_names == ("shoulder", "elbow")
    np.testing.assert_allclose(recording.angles[0], [-np.pi / 2, 0.0], atol=1e-3)  # it starts hanging
    np.testing.assert_array_equal(recording.angles, truth.angle)
    # the velocity that the robot reports is its angle's slope
    slope = np.gradient(truth.angle[:, 0], truth.time)
    assert np.corrcoef(slope, truth.velocity[:, 0])[0, 1] > 0.99
    # command and measurement are two things, and follow each other
    assert not np.array_equal(recording.torques, truth.torque)
    assert np.corrcoef(recording.torques[:, 0], truth.torque[:, 0])[0, 1] > 0.9
    assert np.isnan(load_truth("dfki-20220812-060245").torque).all()  # only the command was logged
    assert np.isfinite(load("dfki-20220812-060245").torques).all()
    static = load("dfki-static")
    assert static.angles.std(axis=0).max() < 1e-3
    np.testing.assert_array_equal(static.torques, 0.0)


def test_toy_pendulum(data_folder):
    recording = load("ibm-0")
    assert recording.frame_interval == pytest.approx(1 / 400)
    np.testing.assert_allclose(median_link_lengths(recording), [0.091, 0.070], rtol=0.01)
    np.testing.assert_array_equal(recording.torques, 0.0)
    # y points up: a passive pendulum spends its last seconds below its pivot, and falls at about g at first
    wrist = recording.keypoint("wrist")[:, 1]
    assert wrist[-400:].mean() < -0.05
    with pytest.raises(InputError, match="no measured truth"):
        load_truth("ibm-0")


def test_options_that_a_name_settles_are_refused(data_folder):
    with pytest.raises(InputError, match="leave --units, --fps out"):
        load("human-arm", units="px", fps=30)


def test_unknown_names():
    with pytest.raises(InputError, match="no recording is named 'dfki'; known are human-arm"):
        load_truth("dfki")
