"""What makes no camera is told in one line."""

import numpy as np
import pytest
from scenes import looking, ring

from invdyn.recordings import InputError
from invdyn.recordings.cameras.camera import Calibration, Camera
from invdyn.recordings.cameras.projection import project

GOOD = {
    "name": "one",
    "matrix": [[1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]],
    "distortion": [0.1],
    "rotation": np.eye(3),
    "translation": [0, 0, 0],
}


def test_coefficients_are_filled_up_with_zeros():
    assert Camera(**GOOD).distortion.tolist() == [0.1, 0, 0, 0, 0]
    assert Camera(**{**GOOD, "distortion": [0.1, 0.2, 0, 0, 0, 0, 0, 0]}).distortion.tolist() == [0.1, 0.2, 0, 0, 0]


@pytest.mark.parametrize(
    ("field", "value", "named"),
    [
        ("matrix", [[1000, 0], [0, 1000]], "shape"),
        ("matrix", [[-1000.0, 0, 320], [0, 1000, 240], [0, 0, 1]], "focal"),
        ("matrix", [[1000.0, 5, 320], [0, 1000, 240], [0, 0, 1]], "skew"),
        ("matrix", "big", "numbers"),
        ("distortion", [0.1, 0, 0, 0, 0, 0.2], "Brown's law has 5"),
        ("distortion", [np.nan], "not finite"),
        ("rotation", np.diag([1.0, 1.0, -1.0]), "matrix is not a rotation"),
        ("rotation", 2 * np.eye(3), "matrix is not a rotation"),
        ("translation", [0, 0], "shape"),
        ("size", (0, 480), "size"),
    ],
)
def test_what_makes_no_camera(field, value, named):
    with pytest.raises(InputError, match=named) as caught:
        Camera(**{**GOOD, field: value})
    assert "\n" not in str(caught.value)
    assert "'one'" in str(caught.value)


def test_a_set_needs_cameras_of_different_names():
    with pytest.raises(InputError, match="two cameras are called 'one'"):
        Calibration((looking("one", (1, 0, 0)), looking("one", (2, 0, 0))), metric=True)
    with pytest.raises(InputError, match="got none"):
        Calibration((), metric=True)
    with pytest.raises(InputError, match="no camera 'cam9'"):
        ring(2).select(["cam1", "cam9"])


def test_scaled_and_turned_scenes_give_the_same_pixels():
    calibration, points = ring(3), np.random.default_rng(0).normal((0, 0, 1), 0.3, (10, 3))
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    changed = calibration.scaled(2.5).rotated(turn)
    for before, after in zip(calibration, changed, strict=True):
        np.testing.assert_allclose(project(after, 2.5 * points @ turn.T), project(before, points), atol=1e-9)
    assert changed.baseline("cam1", "cam2") == pytest.approx(2.5 * calibration.baseline("cam1", "cam2"))
