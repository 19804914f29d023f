"""Readers of the named recordings, on a few rows in each source's layout; test_catalogue.py reads the real files."""

import json

import numpy as np

from invdyn.recordings import median_link_lengths
from invdyn.recordings.public_recordings import read_dfki, read_dfki_film, read_ibm


def csv(path, header, rows):
    path.write_text("\n".join([header, *(",".join(str(cell) for cell in row) for row in rows)]) + "\n")
    return path


def test_a_log_of_the_robot(tmp_path):
    names = [f"{what}{joint}" for what in ("pos_meas", "vel_filt", "tau_meas", "tau_con") for joint in (1, 2)]
    rows = [[t, *(t + k for k in range(8))] for t in (0.0, 0.0, 0.1)]  # one log repeats its first time
    recording, truth = read_dfki(csv(tmp_path / "log.csv", ",".join(["time", *names]), rows))
    np.testing.assert_allclose(recording.time, [0, 0.1])
    np.testing.assert_allclose(recording.angles[0], [-np.pi / 2, 1])  # its zero hangs
    np.testing.assert_allclose(recording.torques[0], [6, 7])  # commanded
    np.testing.assert_allclose(truth.torque[0], [4, 5])  # measured
    np.testing.assert_allclose(truth.velocity[0], [2, 3])


def test_a_log_without_measured_torque(tmp_path):
    rows = [[t, 0, 0, 0, 0, 1, 2] for t in (0.0, 0.1)]
    recording, truth = read_dfki(csv(tmp_path / "log.csv", "time,pos1,pos2,vel1,vel2,tau1,tau2", rows))
    np.testing.assert_allclose(recording.torques, [[1, 2], [1, 2]])
    assert np.isnan(truth.torque).all()


def test_the_film(tmp_path):
    """A camera that is rolled by a right angle: what lies to the right in the picture lies below the shoulder."""
    camera = {"pivot_px": [100, 200], "px_per_m": 1000, "rotation_rad": np.pi / 2}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    names = "t_log,elbow_x,elbow_y,elbow_score,tip_x,tip_y,tip_score,enc_pos_meas1,enc_pos_meas2,"
    names += "enc_vel_filt1,enc_vel_filt2,mean_tau_meas1,mean_tau_meas2,event"
    rows = [[t, 400, 200, 0.9, 620, 200, 0.8, 0, 0, 1, 2, 3, 4, "swing"] for t in (-0.1, 0.0, 5.0, 5.1)]
    recording, truth = read_dfki_film(csv(tmp_path / "film.csv", names, rows), tmp_path / "camera.json")
    np.testing.assert_allclose(recording.time, [0, 5])  # the first 5 s
    np.testing.assert_allclose(recording.keypoints[0], [[0, -0.3], [0, -0.52]], atol=1e-12)
    np.testing.assert_allclose(recording.confidence[0], [0.9, 0.8])
    np.testing.assert_allclose(truth.torque[0], [3, 4])


def test_the_toy(tmp_path):
    """Fifths of pixels as (row, column), rows down; lengths become the documented ones, y points up."""
    fall = np.array([[[1000, 500], [1455, 500], [1805, 500]], [[1000, 500], [1000, 955], [1000, 1305]]])
    (tmp_path / "0.txt").write_text("\n".join(",".join(str(v) for v in row.ravel()) for row in fall) + "\n")
    recording, _ = read_ibm(tmp_path / "0.txt")
    np.testing.assert_allclose(median_link_lengths(recording), [0.091, 0.070], rtol=1e-6)
    np.testing.assert_allclose(recording.keypoints[0, 1], [0, -0.091], atol=1e-9)
    np.testing.assert_allclose(recording.keypoints[1, 1], [0.091, 0], atol=1e-9)
    np.testing.assert_array_equal(recording.torques, 0)
