import numpy as np
import pytest

from invdyn.recordings import (
    InputError,
    Recording,
    check_plausible,
    in_body_lengths,
    load,
    median_link_lengths,
    parse_units,
    write_keypoint_csv,
)


def arm(scale: float = 1.0, frames: int = 3) -> Recording:
    """Shoulder, elbow, wrist on a right angle, links .3 and .4."""
    points = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.4]]) * scale
    return Recording(np.arange(frames) / 10, np.tile(points, (frames, 1, 1)), ("shoulder", "elbow", "wrist"))


def saved(tmp_path, recording):
    write_keypoint_csv(recording, tmp_path / "rec.csv")
    return tmp_path / "rec.csv"


def test_units_are_read():
    assert (parse_units(None).length, parse_units(None).angle) == (None, None)
    assert (parse_units("mm, deg").length, parse_units("deg,mm").angle) == ("mm", "deg")
    for text, words in [
        ("pixels", "unknown unit 'pixels'"),
        ("mm,cm", "two units of length"),
        ("rad,deg", "angle"),
    ]:
        with pytest.raises(InputError, match=words):
            parse_units(text)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)])
def test_lengths_become_metres(tmp_path, unit, factor):
    recording = load(saved(tmp_path, arm(10.0)), units=unit)
    assert recording.length_unit == "m"
    np.testing.assert_allclose(recording.keypoints, arm(10.0 * factor).keypoints, rtol=1e-15)


def test_degrees_become_radians_and_torques_stay(tmp_path):
    (tmp_path / "rec.csv").write_text("time,s_angle,s_torque\n0,90,2\n1,-180,2\n")
    recording = load(tmp_path / "rec.csv", units="deg")
    np.testing.assert_allclose(recording.angles[:, 0], [np.pi / 2, -np.pi])
    np.testing.assert_array_equal(recording.torques, 2.0)


def test_joints_that_shift_stay_in_metres(tmp_path):
    (tmp_path / "rec.csv").write_text("time,rail_angle,swing_angle\n0,0.5,90\n1,1,180\n")
    recording = load(tmp_path / "rec.csv", units="deg", shifting={"rail"})
    np.testing.assert_allclose(recording.angles, [[0.5, np.pi / 2], [1.0, np.pi]])


def test_pixels_turn_up_and_stay_pixels_without_a_scale(tmp_path):
    path = saved(tmp_path, arm(500.0))
    recording = load(path, units="px")
    assert recording.length_unit == "px"
    np.testing.assert_array_equal(recording.keypoints, arm(500.0).keypoints * [1, -1])
    scaled = load(path, units="px", scale=0.002)
    assert scaled.length_unit == "m"
    np.testing.assert_allclose(scaled.keypoints, arm().keypoints * [1, -1])
    with pytest.raises(InputError, match="needs --units px"):
        load(path, units="mm", scale=0.002)


def test_pixels_in_three_dimensions_are_refused(tmp_path):
    (tmp_path / "rec.csv").write_text("time,a_x,a_y,a_z\n0,1,1,1\n1,1,1,1\n")
    with pytest.raises(InputError, match="three coordinates"):
        load(tmp_path / "rec.csv", units="px")


@pytest.mark.parametrize("units", [None, "m"])
@pytest.mark.parametrize("points", [("shoulder", "elbow", "wrist"), ("wrist",)])
def test_pixels_declared_as_metres_are_refused(tmp_path, units, points):
    """A lone keypoint is judged by its travel; rows with a command alone do not count."""
    header = "time,motor_torque," + ",".join(f"{p}_x,{p}_y" for p in points)
    film = [f"{t / 30},1" + "".join(f",{100 * t + 50 * p},{80}" for p in range(len(points))) for t in range(3)]
    commands = [f"{1 + t / 1000},1" + ",," * len(points) for t in range(20)]
    (tmp_path / "rec.csv").write_text("\n".join([header, *film, *commands]) + "\n")
    with pytest.raises(InputError, match="look like pixels: pass --units px"):
        load(tmp_path / "rec.csv", units=units)


def test_degrees_taken_for_radians_are_refused_unless_declared(tmp_path):
    (tmp_path / "rec.csv").write_text("time,s_angle\n0,90\n1,-180\n")
    with pytest.raises(InputError, match="look like degrees: pass --units deg"):
        load(tmp_path / "rec.csv")
    assert load(tmp_path / "rec.csv", units="rad").angles[1, 0] == -180


def test_link_lengths_that_no_picture_shows_are_refused():
    """A picture shortens, and never stretches; a length that is guessed may be off by three either way."""
    check_plausible(arm(), (0.3, 0.4))
    check_plausible(arm(1.4), (0.3, 0.4))
    check_plausible(arm(0.35), (0.3, 0.4))
    check_plausible(arm(2.9), (0.3, 0.4), guessed=True)
    with pytest.raises(InputError, match=r"shoulder and elbow lie 0.6 m apart .* link is 0.3 m .* uncertain ones may"):
        check_plausible(arm(2.0), (0.3, 0.4))
    check_plausible(arm(), (0.3, 0.4, 0.5, 0.6))  # another chain: nothing to compare
    with pytest.raises(InputError, match=r"shoulder and elbow lie 0.93 m apart .* link is 0.3 m"):
        check_plausible(arm(3.1), (0.3, 0.4), guessed=True)
    tips = Recording(arm().time, arm().keypoints[:, 1:], ("elbow", "wrist"))
    check_plausible(tips, (0.3, 0.4))
    check_plausible(tips, (30.0, 0.4), base=None)  # where the base is, nobody knows
    with pytest.raises(InputError, match="the base and elbow"):
        check_plausible(tips, (30.0, 0.4))
    with pytest.raises(InputError, match="scale the keypoints to the body's unit"):
        check_plausible(arm(500.0).scaled(1.0, "px"), (0.3, 0.4))


def test_median_link_lengths_and_body_lengths():
    recording = arm(frames=5)
    keypoints = recording.keypoints.copy()
    keypoints[0, 2] = np.nan
    keypoints[1, 2] = 99.0  # an outlier
    recording = Recording(recording.time, keypoints, recording.keypoint_names)
    np.testing.assert_allclose(median_link_lengths(recording), [0.3, 0.4])
    np.testing.assert_allclose(median_link_lengths(recording, ("wrist", "shoulder")), [0.5])
    normal = in_body_lengths(recording)
    assert normal.length_unit == "body length"
    np.testing.assert_allclose(median_link_lengths(normal).sum(), 1.0)
    keypoints[:, 1] = np.nan
    with pytest.raises(InputError, match="never seen together"):
        in_body_lengths(Recording(recording.time, keypoints, recording.keypoint_names))


@pytest.mark.parametrize(
    ("factor", "odd"), [(1000.0, ["elbow_x"]), (1000.0, ["wrist_x", "wrist_y"]), (100.0, ["wrist_y"])]
)
def test_columns_in_two_units_are_named(tmp_path, factor, odd):
    """All in one unit, they are told of as before."""
    place = {f"{name}_{axis}": (k, a) for k, name in enumerate(("elbow", "wrist")) for a, axis in enumerate("xy")}
    tips = Recording(arm().time, arm().keypoints[:, 1:] + 0.1, ("elbow", "wrist"))
    keypoints = tips.keypoints.copy()
    for name in odd:
        keypoints[(slice(None), *place[name])] *= factor
    mixed = Recording(tips.time, keypoints, tips.keypoint_names)
    with pytest.raises(InputError, match=rf"{', '.join(odd)} (is|are) about .* one unit in all columns"):
        check_plausible(load(saved(tmp_path, mixed)), (0.3, 0.4), base=None)
    with pytest.raises(InputError, match="look like pixels"):
        load(saved(tmp_path, tips.scaled(1000.0, "m")))
