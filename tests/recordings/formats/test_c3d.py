"""Markers of C3D files, as `ezc3d` writes them."""

import numpy as np
import pytest

from invdyn.recordings import InputError, load

ezc3d = pytest.importorskip("ezc3d")
POINTS = np.random.default_rng(0).normal(300.0, 50.0, (3, 4, 6))
"""mm, of four trajectories in six frames."""
LABELS = ("Ada:LELB", "Ada:LWRI", "*11", "LElbowAngles")


@pytest.fixture
def write(tmp_path):
    """A function that writes a file, with other labels, unit and upright axis."""

    def written(labels=LABELS, unit="mm", up=None, points=POINTS):
        file = ezc3d.c3d()
        own = file["parameters"]["POINT"]
        own["RATE"]["value"], own["LABELS"]["value"], own["UNITS"]["value"] = [120], labels, (unit,)
        file.add_parameter("POINT", "ANGLES", ["LElbowAngles"])
        if up is not None:
            file.add_parameter("POINT", "Y_SCREEN", [up])
        file["data"]["points"] = np.concatenate([points, np.ones((1, *points.shape[1:]))])
        file.write(str(tmp_path / "walk.c3d"))
        return tmp_path / "walk.c3d"

    return written


def test_markers_are_read_in_metres_at_the_files_rate(write):
    seen = POINTS.copy()
    seen[:, 1, 3] = np.nan
    recording = load(write(points=seen, up="+Z"))
    assert recording.keypoint_names == ("LELB", "LWRI")
    assert recording.length_unit == "m"
    np.testing.assert_allclose(recording.time, np.arange(6) / 120)
    np.testing.assert_allclose(recording.keypoints, 1e-3 * seen[:, :2].transpose(2, 1, 0), rtol=1e-6)
    with pytest.raises(InputError, match="leave --units out"):
        load(write(), units="mm")


def test_z_is_up_where_the_file_has_y(write):
    with pytest.warns(UserWarning, match="y is up in this file"):
        recording = load(write(up="+Y"))
    x, y, z = 1e-3 * POINTS[:, 0]
    np.testing.assert_allclose(recording.keypoint("LELB"), np.stack([x, -z, y], -1), rtol=1e-6)


def test_one_of_several_subjects_is_chosen(write):
    file = write(labels=("Ada:LELB", "Bob:LELB", "*11", "*12"))
    np.testing.assert_allclose(load(file, individual="Bob").keypoints[:, 0], 1e-3 * POINTS[:, 1].T, rtol=1e-6)
    with pytest.raises(InputError, match="choose one of Ada, Bob"):
        load(file)


def test_more_labels_than_a_parameter_holds(write):
    many = np.repeat(POINTS[:, :1], 300, 1) + np.arange(300)[:, None]
    recording = load(write(labels=tuple(f"m{k}" for k in range(300)), points=many))
    assert recording.keypoint_names[-1] == "m299"
    np.testing.assert_allclose(recording.keypoints[:, 299], 1e-3 * many[:, 299].T, rtol=1e-6)


def test_what_cannot_be_read_is_said_in_a_line(write, tmp_path):
    with pytest.raises(InputError, match="POINT:UNITS is 'inch': expected m, cm or mm"):
        load(write(unit="inch"))
    with pytest.raises(InputError, match="expected labelled markers, got none"):
        load(write(labels=("*1", "*2", "*3", "*4")))
    whole = write().read_bytes()
    for size, words in ((len(whole) - 300, "was cut off"), (100, "expected a C3D file"), (0, "expected a C3D file")):
        (tmp_path / "cut.c3d").write_bytes(whole[:size])
        with pytest.raises(InputError, match=words):
            load(tmp_path / "cut.c3d")
