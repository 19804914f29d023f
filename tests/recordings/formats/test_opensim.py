import numpy as np
import pytest

from invdyn.recordings import InputError, load, median_link_lengths, read_sto, write_moments, write_sto

TIME = np.array([0.0, 0.1, 0.25])
MOMENT = np.array([[1.0, -2.0], [0.123456789, 3e-7], [1e4, np.nan]])
COORDINATES = ("r_shoulder_elev", "r_elbow_flex")

TRC = """PathFileType\t4\t(X/Y/Z)\tarm.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
10\t10\t2\t2\tmm\t10\t1\t2
Frame#\tTime\tshoulder\t\t\telbow\t\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0\t100\t200\t300\t400\t500\t600\t
2\t0.1\t100\t200\t300
"""


def test_moments_read_back(tmp_path):
    write_moments(tmp_path / "out.sto", TIME, MOMENT, MOMENT - 1, MOMENT + 1, COORDINATES)
    columns = read_sto(tmp_path / "out.sto")
    assert list(columns) == ["time", *(f"{c}_{end}" for end in ("moment", "q05", "q95") for c in COORDINATES)]
    np.testing.assert_allclose(columns["time"], TIME)
    np.testing.assert_allclose(columns["r_elbow_flex_moment"], MOMENT[:, 1], rtol=1e-9)
    np.testing.assert_allclose(columns["r_shoulder_elev_q05"], MOMENT[:, 0] - 1, rtol=1e-9)
    np.testing.assert_allclose(columns["r_shoulder_elev_q95"], MOMENT[:, 0] + 1, rtol=1e-9)


def test_the_layout_is_opensims(tmp_path):
    write_sto({"time": TIME, "a_moment": MOMENT[:, 0]}, tmp_path / "out.sto", name="Torques")
    lines = (tmp_path / "out.sto").read_text().splitlines()
    assert lines[:7] == [
        "Torques",
        "version=1",
        "nRows=3",
        "nColumns=2",
        "inDegrees=no",
        "endheader",
        "time\ta_moment",
    ]
    assert len(lines) == 10
    assert lines[7].split("\t") == ["0", "1"]


def test_the_layout_is_that_of_a_file_by_opensim(tmp_path, data_folder):
    theirs = data_folder / "opensim_arm26" / "arm26_InverseDynamics_Filtered.sto"
    columns = read_sto(theirs)
    assert [len(values) for values in columns.values()] == [121, 121, 121]
    write_sto(columns, tmp_path / "ours.sto")
    assert (tmp_path / "ours.sto").read_text().splitlines()[:7] == theirs.read_text().splitlines()[:7]
    for label, values in read_sto(tmp_path / "ours.sto").items():
        np.testing.assert_allclose(values, columns[label], rtol=1e-9)


def test_shapes_and_time_are_checked(tmp_path):
    with pytest.raises(InputError, match=r"q95 must have shape \(3, 2\), got \(3,\)"):
        write_moments(tmp_path / "out.sto", TIME, MOMENT, MOMENT, MOMENT[:, 0], COORDINATES)
    with pytest.raises(InputError, match="first column"):
        write_sto({"a": TIME}, tmp_path / "out.sto")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no line 'endheader'"),
        ("name\nversion=1\nendheader\n", "no line 'endheader' with labels"),
        ("name\nendheader\ntime\ta\n", "only a header"),
        ("name\nnColumns=3\nendheader\ntime\ta\n0\t1\n1\t1\n", "nColumns=3, but there are 2"),
        ("name\nendheader\ntime\ta\n0\t1\n1\tx\n", r"row 2 \(line 5\), column 'a': 'x' is not a number"),
        ("name\nendheader\ntime\ta\n0\t1\n1\n", "row 2 .* has 1 cells, the header has 2"),
    ],
)
def test_broken_sto(tmp_path, text, words):
    (tmp_path / "bad.sto").write_text(text)
    with pytest.raises(InputError, match=words):
        read_sto(tmp_path / "bad.sto")


def test_markers_come_in_metres_with_z_up(tmp_path):
    (tmp_path / "arm.trc").write_text(TRC)
    with pytest.warns(UserWarning, match=r"y is up in this file, .*: \(x, y, z\) is read as \(x, −z, y\)$"):
        recording = load(tmp_path / "arm.trc")
    np.testing.assert_allclose(recording.keypoints[0], [[0.1, -0.3, 0.2], [0.4, -0.6, 0.5]])
    np.testing.assert_allclose(recording.time, [0.0, 0.1])
    assert np.isnan(recording.keypoints[1, 1]).all()
    for options, words in [({"fps": 10}, "--fps out"), ({"units": "mm"}, "--units out")]:
        with pytest.raises(InputError, match=words):
            load(tmp_path / "arm.trc", **options)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("PathFileType", "Path", "PathFileType"),
        ("\tmm\t", "\tinch\t", "'inch'"),
        ("\t600", "\tsix", "'elbow Z': 'six'"),
    ],
)
def test_broken_trc(tmp_path, old, new, words):
    (tmp_path / "bad.trc").write_text(TRC.replace(old, new))
    with pytest.raises(InputError, match=words):
        load(tmp_path / "bad.trc")


def test_a_real_marker_file(data_folder):
    with pytest.warns(UserWarning, match="y is up"):
        recording = load(data_folder / "opensim_arm26" / "arm26_elbow_flex.trc")
    assert recording.keypoint_names == ("r_acromion", "r_humerus_epicondyle", "r_radius_styloid")
    assert recording.num_frames == 121
    upper_arm, forearm = median_link_lengths(recording)
    assert 0.25 < upper_arm < 0.4  # the limbs of a person, in metres
    assert 0.2 < forearm < 0.35
    assert recording.keypoint("r_acromion")[0, 2] > recording.keypoint("r_radius_styloid")[0, 2]  # arm hangs


MOT = """Coordinates
version=1
nRows=2
nColumns=3
inDegrees=yes

endheader
time\trail\tswing
0\t0.5\t90
0.1\t1\t45
"""


@pytest.mark.parametrize(
    "header", ["inDegrees=yes", "inDegrees = Yes", "indegrees=YES ", "inDegrees=no", "", "inDegrees=yes,,"]
)
def test_degrees_of_a_motion_are_those_of_joints_that_turn(tmp_path, header):
    path, degrees = tmp_path / "walk.mot", "yes" in header.lower()
    path.write_text(MOT.replace("inDegrees=yes", header))
    angles = [[0.5, np.pi / 2], [1.0, np.pi / 4]] if degrees else [[0.5, 90.0], [1.0, 45.0]]
    recording = load(path, shifting={"rail"}, units=None if degrees else "rad")
    np.testing.assert_allclose(recording.angles, angles)
    if not degrees:  # a header may be missing, or wrong
        by_option = load(path, shifting={"rail"}, units="deg")
        np.testing.assert_allclose(by_option.angles, [[0.5, np.pi / 2], [1.0, np.pi / 4]])


def test_a_motion_in_what_is_no_unit_is_refused(tmp_path):
    (tmp_path / "walk.mot").write_text(MOT.replace("=yes", "=grad"))
    with pytest.raises(InputError, match="inDegrees=grad: expected yes or no"):
        load(tmp_path / "walk.mot")


def test_a_motion_that_was_cut_off_is_read_with_a_warning(tmp_path):
    (tmp_path / "walk.mot").write_text(MOT.replace("nRows=2", "nRows=250"))
    with pytest.warns(UserWarning, match="nRows=250, and there are 2: was the file cut off"):
        assert load(tmp_path / "walk.mot").num_frames == 2


def test_a_motion_may_be_called_sto(tmp_path):
    for name in ("walk.mot", "walk.sto"):
        (tmp_path / name).write_text(MOT)
    np.testing.assert_array_equal(load(tmp_path / "walk.sto").angles, load(tmp_path / "walk.mot").angles)


def test_header_values_of_a_trc_may_stand_several_tabs_apart(tmp_path):
    lines = TRC.split("\n")
    lines[2] = "\t\t".join(f"  {value} " for value in lines[2].split("\t"))
    (tmp_path / "wide.trc").write_text("\n".join(lines))
    (tmp_path / "arm.trc").write_text(TRC)
    wide, usual = (load(tmp_path / name, plane="xy") for name in ("wide.trc", "arm.trc"))
    np.testing.assert_array_equal(wide.keypoints, usual.keypoints)


def test_tables_separated_by_commas_are_read(tmp_path):
    for name, text in (("walk.mot", MOT), ("arm.trc", TRC)):
        (tmp_path / name).write_text(text)
        (tmp_path / f"commas_{name}").write_text(text.replace("\t", ",").replace("endheader", "endheader,,"))
    for name, options in (("walk.mot", {}), ("arm.trc", {"plane": "xy"})):
        expected, read = load(tmp_path / name, **options), load(tmp_path / f"commas_{name}", **options)
        for field in ("time", "keypoints", "angles"):
            if getattr(expected, field) is not None:
                np.testing.assert_array_equal(getattr(read, field), getattr(expected, field))
        assert (read.keypoint_names, read.joint_names) == (expected.keypoint_names, expected.joint_names)


def test_decimal_commas_are_refused_in_one_line(tmp_path):
    (tmp_path / "walk.mot").write_text(MOT.replace("0.5", "0,5"))
    with pytest.raises(InputError, match="column 'rail': '0,5' is not a number"):
        load(tmp_path / "walk.mot")
