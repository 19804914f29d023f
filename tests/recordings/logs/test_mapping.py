"""Numbers of a motor, and of a joint's range: what a mapping's `gear`, `range` and `ends` make of them."""

import json
from pathlib import Path

import numpy as np
import pytest

from invdyn.recordings import InputError
from invdyn.recordings.logs import LogMap
from invdyn.recordings.logs.tracks import Track

VALUES = np.array([-100.0, 0.0, 100.0])
CALIBRATION = {
    "elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 7, "range_min": 1024, "range_max": 3072},
    "wrist": {"id": 4, "drive_mode": 1, "homing_offset": 7, "range_min": 1024, "range_max": 3072},
}


def source(kind: str = "angle", folder: Path = Path(), **keys):
    """The source of a joint's line with these keys."""
    table = {"track": "state.elbow_flex.pos", **keys}
    return getattr(LogMap.of({"joints": {"elbow": {kind: table}}}, folder).joints["elbow"], kind)


def read(values=VALUES, **keys) -> np.ndarray:
    own = source(**keys)
    return own.of({own.track: Track.of(np.arange(len(values)), np.asarray(values))}, "elbow").values


@pytest.mark.parametrize("gear", [3.0, -1.0, 0.5])
def test_a_target_at_the_motor_is_the_joints_over_its_gear(gear):
    """MuJoCo compares ctrl with gear · q."""
    np.testing.assert_allclose(read(kind="target", gear=gear), VALUES / gear)
    np.testing.assert_allclose(read(kind="torque", gear=gear), VALUES * gear)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"range": [-1.92, 1.71]}, [-1.92, -0.105, 1.71]),
        ({"range": [1.71, -1.92]}, [1.71, -0.105, -1.92]),
        ({"range": [-110, 98], "unit": "deg"}, np.radians([-110, -6, 98])),
        ({"range": [-1.0, 1.0], "sign": -1, "zero": 0.5}, [1.5, 0.5, -0.5]),
        ({"range": [-1.0, 2.0], "ends": [0, 100]}, [-4.0, -1.0, 2.0]),
        ({"range": [0, 40], "ends": [0, 100], "unit": "mm"}, [-0.04, 0.0, 0.04]),
    ],
)
def test_a_range_is_reached_at_its_ends(keys, expected):
    np.testing.assert_allclose(read(**keys), expected, atol=1e-12)


def test_numbers_of_another_unit_are_scaled_about_the_same_zero():
    bare = LogMap.of({"joints": {"elbow": {"angle": {"track": "q", "range": [-110, 98]}}}})
    stated = LogMap.of({"joints": {"elbow": {"angle": {"track": "q", "range": [-110, 98], "unit": "deg"}}}})
    episode = {"q": Track.of(np.arange(3), VALUES)}
    righted = bare.rescaled(angle=np.pi / 180).joints["elbow"].angle
    np.testing.assert_allclose(righted.of(episode, "").values, stated.joints["elbow"].angle.of(episode, "").values)


@pytest.mark.parametrize(("motor", "way"), [("elbow_flex", 1), ("wrist", -1)])
def test_lerobots_calibration_says_a_motors_range(tmp_path, motor, way):
    """2048 ticks of 4096 are half a turn; `drive_mode` 1 counts them the other way."""
    (tmp_path / "arm.json").write_text(json.dumps(CALIBRATION))
    table = {"track": f"observation.state.{motor}.pos", "range": "arm.json", "zero": 0.25}
    own = LogMap.of({"joints": {"elbow": {"angle": table}}}, tmp_path).joints["elbow"].angle
    values = own.of({own.track: Track.of(np.arange(3), VALUES)}, "").values
    np.testing.assert_allclose(values, 0.25 + way * np.pi / 2 * np.array([-1, 0, 1]), atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"gear": 0}, "expected a gear other than 0"),
        ({"gear": "three"}, "expected gear as a number"),
        ({"gear": 5e-324}, "expected numbers of a usual size"),
        ({"range": [1.0, 1.0]}, "range: expected two numbers that differ"),
        ({"range": [0.0, 5e-324]}, "expected a range of a usual size"),
        ({"range": [0.0, float("nan")]}, "range: expected two numbers that differ"),
        ({"range": [0.0, True]}, "range: expected two numbers that differ"),
        ({"range": 1.0}, "range: expected two numbers that differ"),
        ({"range": [0, 1], "ends": [0, 0]}, "ends: expected two numbers that differ"),
        ({"ends": [0, 100]}, "ends are of a range"),
        ({"range": "none.json"}, "no calibration"),
        ({"range": "bad.json"}, "expected LeRobot's calibration"),
        ({"range": "deep.json"}, "expected LeRobot's calibration"),
        ({"range": "others.json"}, "expected the name of one motor of others.json"),
        ({"range": "words.json"}, "expected range_min and range_max in ticks"),
        ({"range": "arm.json", "unit": "deg"}, "a calibration's range is in rad"),
    ],
)
def test_what_is_no_gear_and_no_range_is_one_line(tmp_path, keys, says):
    (tmp_path / "arm.json").write_text(json.dumps(CALIBRATION))
    (tmp_path / "bad.json").write_text("{")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "others.json").write_text(json.dumps({"hip": CALIBRATION["wrist"]}))
    (tmp_path / "words.json").write_text(json.dumps({"elbow_flex": {"range_min": "low", "range_max": 1}}))
    with pytest.raises(InputError, match=says) as error:
        source(folder=tmp_path, **keys)
    assert "\n" not in str(error.value)


def test_a_torque_has_no_range():
    with pytest.raises(InputError, match="unknown key 'range'"):
        source(kind="torque", range=[0, 1])


def test_numbers_that_begin_again_are_one_course_with_a_wrap():
    ticks = np.arange(0, 9000.0, 500)
    ticks[3] = np.nan
    source = LogMap.of({"joints": {"j": {"angle": {"track": "q", "wrap": 4096, "sign": -1}}}}).joints["j"].angle
    found = source.of({"q": Track(np.arange(len(ticks)), ticks % 4096)}, "j").values
    np.testing.assert_allclose(found, -ticks)
    with pytest.raises(InputError, match="expected wrap as the positive number"):
        LogMap.of({"joints": {"j": {"angle": {"track": "q", "wrap": 0}}}})


def test_motors_that_add_are_a_matrix_row_by_row():
    """A wrist by two motors: torques Aᵀ τ, angles A⁻¹ q of the motors, each in its own unit and gear."""
    torques, angles = np.array([[1.0, 2.0, -1.0], [0.5, -0.5, 3.0]]), np.array([[0.0, 90.0, 30.0], [0.2, 0.1, -0.4]])
    lines = {
        "bend": {
            "torque": [{"track": "i1", "gear": 45}, {"track": "i2", "gear": 32, "sign": -1}],
            "angle": [{"track": "p1", "unit": "deg", "gear": 2}, {"track": "p2", "gear": 4, "zero": 0.3}],
        },
        "roll": {"torque": {"track": "i2", "gear": 32}, "angle": "p2"},
    }
    mapping = LogMap.of({"joints": lines})
    assert mapping.needed().tracks == {"i1", "i2", "p1", "p2"}
    time = np.arange(3.0)
    named = dict(zip(("i1", "i2", "p1", "p2"), (*torques, *angles), strict=True))
    episode = {name: Track.of(time, values) for name, values in named.items()}
    bend = mapping.joints["bend"]
    np.testing.assert_allclose(bend.torque.of(episode, "bend").values, [45, -32] @ torques)
    expected = np.radians(angles[0]) / 2 + angles[1] / 4 + 0.3
    np.testing.assert_allclose(bend.angle.of(episode, "bend").values, expected)
    twice = mapping.rescaled(angle=2.0).joints["bend"].angle
    np.testing.assert_allclose(twice.of(episode, "bend").values, 2 * (expected - 0.3) + 0.3)


@pytest.mark.parametrize("given", [[], [3], [["a", "b"], "c"], [{"track": "a"}, {"track": "b", "gear": 0}]])
def test_no_sum_of_tracks_is_one_line(given):
    with pytest.raises(InputError, match=r"^joints\.elbow\.torque: expected"):
        LogMap.of({"joints": {"elbow": {"torque": given}}})
