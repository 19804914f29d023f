import numpy as np
import pytest

from invdyn.recordings import InputError, Truth, read_truth, write_truth


def swing() -> Truth:
    time = np.linspace(0.0, 1.0, 5)
    return Truth(time, np.outer(time, [1, 2]), np.ones((5, 2)), np.full((5, 2), np.nan), ("shoulder", "elbow"))


def test_round_trip(tmp_path):
    write_truth(swing(), tmp_path / "truth.csv")
    header = (tmp_path / "truth.csv").read_text().splitlines()[0]
    assert header.startswith("time,shoulder_torque,elbow_torque,shoulder_angle,")
    back = read_truth(tmp_path / "truth.csv")
    assert back.joint_names == ("shoulder", "elbow")
    for field in ("time", "angle", "velocity", "torque"):
        np.testing.assert_array_equal(getattr(back, field), getattr(swing(), field))


def test_interpolates_and_never_extrapolates():
    at = swing().at(np.array([-0.1, 0.3, 1.0, 1.1]))
    np.testing.assert_allclose(at.angle[1:3], [[0.3, 0.6], [1.0, 2.0]])
    assert np.isnan(at.angle[[0, 3]]).all()


def test_refuses_other_shapes_and_files(tmp_path):
    with pytest.raises(InputError, match=r"velocity must have shape \(5, 2\)"):
        Truth(swing().time, swing().angle, np.ones(5), swing().torque, ("shoulder", "elbow"))
    path = tmp_path / "truth.csv"
    for text, words in [
        ("t,a_torque\n0,1\n1,1\n", "no column 'time'"),
        ("time,a_torque,a_speed\n0,1,1\n1,1,1\n", "odd: a_speed"),
        ("time\n0\n1\n", "no joint"),
        ("time,a_torque\n0,1\n1,1e8\n", "truth: torque"),
        ("time,a_torque,a_angle,a_velocity\n1,1,1,1\n0,1,1,1\n", r"backwards at row 2 \(line 3\)"),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=words) as caught:
            read_truth(path)
        assert str(caught.value).startswith(f"{path}: ")


def test_what_a_file_lacks_is_unknown(tmp_path):
    """Torques alone are a truth, and a joint may have less than another."""
    path = tmp_path / "truth.csv"
    path.write_text("time,upper_arm_torque,b_angle\n0,1,2\n1,3,4\n")
    truth = read_truth(path)
    assert truth.joint_names == ("upper_arm", "b")
    np.testing.assert_array_equal(truth.torque, [[1, np.nan], [3, np.nan]])
    np.testing.assert_array_equal(truth.angle, [[np.nan, 2], [np.nan, 4]])
    assert np.isnan(truth.velocity).all()
