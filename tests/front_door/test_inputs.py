"""What a command is given: where the tips of a tracked base lie."""

import warnings

import numpy as np
import pytest
from servo_log import SERVO_ARM, write_mapping, write_servo_log

from invdyn.inputs import load_recording, read_logs
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording, write_keypoint_csv

ROD = Link("rod", "pivot", "tip", length=0.3, mass=1.0)
TIME = 0.02 * np.arange(30)
ANGLE = np.sin(3 * TIME)
TIP = 0.3 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], -1)


@pytest.mark.parametrize("base", [(0.0, 0.0), (0.4, -0.2)])
@pytest.mark.parametrize("tracked", [False, True])
def test_tips_lie_about_the_bodys_base(base, tracked, tmp_path):
    """A tracked base takes the frame's own shift away; a base that is not tracked is where the body says."""
    shift = np.array([5.0, 7.0]) if tracked else np.array(base)
    points, names = (TIP + shift)[:, None], ("tip",)
    if tracked:
        points, names = np.concatenate([np.broadcast_to(shift, (30, 1, 2)), points], 1), ("pivot", "tip")
    file = tmp_path / "rec.csv"
    write_keypoint_csv(Recording(TIME, points, names), file)
    body = planar_body("arm", [ROD], base=base)
    recording = load_recording(str(file), body)
    assert recording.keypoint_names == (("pivot", "tip") if tracked else ("tip",))
    np.testing.assert_allclose(recording.keypoint("tip"), TIP + np.array(base), atol=1e-6)


def test_a_base_that_moves_is_kept_to_infer_and_said_to_a_diagnosis(tmp_path):
    """A diagnosis gets keypoints less its track, or as they were filmed, and a warning; one at rest is no matter."""
    time = np.arange(60) / 30
    tip = np.stack([0.3 * np.cos(time), 0.3 * np.sin(time)], -1)
    walk = np.stack([0.02 * np.sin(2 * np.pi * time), 0.03 * np.cos(4 * np.pi * time)], -1)
    body, file = planar_body("arm", [ROD], base=(0.4, -0.2)), tmp_path / "rec.csv"
    noise = 0.001 * np.random.default_rng(0).standard_normal((60, 2, 2))
    for base, moves in ((walk, True), (0.0 * walk, False)):
        points = np.stack([base, base + tip], 1) + noise + np.array(body.base)
        write_keypoint_csv(Recording(time, points, ("pivot", "tip")), file)
        kept = load_recording(str(file), body)
        assert kept.keypoint_names == ("pivot", "tip")
        np.testing.assert_allclose(np.median(kept.keypoint("pivot"), 0), body.base, atol=1e-6)
        np.testing.assert_allclose(np.diff(kept.keypoints, axis=0), np.diff(points, axis=0), atol=1e-6)
        for given in ({}, {"base": "pivot"}):
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                filmed = load_recording(str(file), body, as_filmed=True, **given)
            assert filmed.keypoint_names == ("tip",)
            lines = [str(each.message) for each in said]
            assert [("a diagnosis takes it to be at rest" in line) for line in lines] == [True] * moves
            expected = points[:, 1]
            if given:
                away = points[:, 0] if moves else np.median(points[:, 0], 0)
                expected = expected - away + np.array(body.base)
            np.testing.assert_allclose(filmed.keypoints[:, 0], expected, atol=1e-6)


def test_a_tracked_base_in_three_dimensions_is_one_line(tmp_path):
    points = np.zeros((30, 2, 3))
    points[:, 1, :2] = TIP
    points[:, 1, 2] = 0.01 * TIME
    file = tmp_path / "rec.csv"
    write_keypoint_csv(Recording(TIME, points, ("pivot", "tip")), file)
    body = planar_body("arm", [ROD], base=(0.4, -0.2))
    with pytest.raises(InputError, match=r"rec\.csv: .* three coordinates .* plane=xy"):
        load_recording(str(file), body, base="pivot")


def test_every_command_reads_a_robots_log(folder, quick_inference, run):
    """The same recording as a diagnosis has: angles and commands as the robot's file counts them."""
    SERVO_ARM.to_toml(folder / "robot.toml")
    write_servo_log(folder / "log.csv")
    write_mapping(folder / "map.toml")
    call = ("log.csv", "--map", "map.toml", "--body", "robot.toml", "--out")
    outcome = run("infer", *call, "p.nc")
    assert outcome.exit_code == 0, outcome.output
    (log,) = read_logs("log.csv", SERVO_ARM, "map.toml")
    recording = quick_inference[0]["recording"]
    np.testing.assert_array_equal(recording.angles, log.recording.angles)
    np.testing.assert_array_equal(recording.torques, log.recording.torques)
    refused = run("infer", *call, "p.nc", "--set", "episodes=0,0")
    assert "expected one recording, got 2 episodes" in refused.stderr
