import numpy as np
import pytest

from invdyn.recordings import InputError, Recording, load
from invdyn.recordings.plane import PLANES, planar

TIME = np.arange(20) / 50
POINTS = np.random.default_rng(5).uniform(-0.3, 0.3, (20, 2, 3))


def solid(constant=None):
    points = POINTS.copy()
    if constant is not None:
        points[..., constant] = 1.5
    return Recording(TIME, points, ("elbow", "wrist"))


@pytest.mark.parametrize("plane", PLANES)
def test_two_axes_are_chosen_in_their_order(plane):
    places = ["xyz".index(axis) for axis in plane]
    np.testing.assert_array_equal(planar(solid(), plane).keypoints, POINTS[..., places])


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_constant_axis_is_left_out_and_said(axis):
    with pytest.warns(UserWarning, match=f"coordinate {'xyz'[axis]} is 1.5 throughout: left out"):
        flat = planar(solid(axis), "flat")
    np.testing.assert_array_equal(flat.keypoints, np.delete(POINTS, axis, -1))


def test_what_cannot_be_chosen_is_said():
    with pytest.raises(InputError, match=r"three coordinates .* --set plane"):
        planar(solid(), "flat")
    for plane in ("xx", "ab", "xyz"):
        with pytest.raises(InputError, match="one of xy, xz"):
            planar(solid(), plane)
    flat = Recording(TIME, POINTS[..., :2], ("elbow", "wrist"))
    assert planar(flat, "flat") is flat
    with pytest.raises(InputError, match="this file has two"):
        planar(flat, "xy")


def trc(points) -> str:
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tarm.trc",
        "DataRate\tUnits",
        "50\tcm",
        "Frame#\tTime\telbow\t\t\twrist\t\t",
        "",
        "",
    ]
    for t, row in enumerate(100 * points):
        lines.append("\t".join([str(t), f"{t / 50}", *(f"{value:.9f}" for value in row.ravel())]))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("plane", [None, "xy", "xz", "zy"])
def test_a_trc_is_laid_on_its_own_axes(tmp_path, plane):
    points = POINTS.copy()
    if plane is None:
        points[..., 2] = -0.25
    (tmp_path / "arm.trc").write_text(trc(points))
    if plane is None:
        with pytest.warns(UserWarning, match="coordinate z is -0.25 throughout"):
            recording = load(tmp_path / "arm.trc", plane="flat")
    else:
        recording = load(tmp_path / "arm.trc", plane=plane)
    places = ["xyz".index(axis) for axis in plane or "xy"]
    np.testing.assert_allclose(recording.keypoints, points[..., places], atol=1e-9)
