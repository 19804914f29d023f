"""Times, speeds and angles that a body can have, and gaps between rows."""

from dataclasses import replace

import numpy as np
import pytest

from invdyn.recordings import InputError, Recording, bridged, check_plausible, in_body_lengths, load, names, parse_units
from invdyn.recordings.limits import PLAUSIBLE
from invdyn.recordings.pace import froude, swing

LENGTHS = (0.4, 0.35)
RATE = 50.0


def arm(frames=150, amplitude=0.35, frequency=0.4, encoders=False, keypoints=True):
    """Two links that swing gently, in s, m and rad."""
    time = np.arange(frames) / RATE
    angles = amplitude * np.stack([np.sin(2 * np.pi * frequency * time), np.cos(3 * np.pi * frequency * time)], -1)
    direction = np.cumsum(angles, axis=-1)
    steps = np.array(LENGTHS)[:, None] * np.stack([np.cos(direction), np.sin(direction)], -1)
    return Recording(
        time,
        np.cumsum(steps, axis=1) if keypoints else np.empty((frames, 0, 2)),
        ("elbow", "wrist") if keypoints else (),
        angles=angles if encoders else None,
        joint_names=("shoulder", "elbow") if encoders else (),
    )


def timed(recording, time):
    return Recording(time, recording.keypoints, recording.keypoint_names)


def test_a_swing_and_a_froude_number():
    assert swing(0.994) == pytest.approx(2.0, rel=1e-3)  # the seconds pendulum
    time = np.arange(400) / 200
    turning = 0.5 * np.stack([np.cos(6 * time), np.sin(6 * time)], -1)
    assert froude(turning, time, 0.5) == pytest.approx(6.0**2 * 0.5 / 9.81, rel=0.02)  # ω² L / g, over chords
    noisy = turning + 0.002 * np.random.default_rng(0).standard_normal(turning.shape)
    assert froude(noisy, time, 0.5) == pytest.approx(6.0**2 * 0.5 / 9.81, rel=0.1)
    noisy[::9] = [3.0, 3.0]  # lost points
    assert froude(noisy, time, 0.5) < PLAUSIBLE.froude


def test_an_arm_in_body_lengths_is_not_told_in_metres():
    late = timed(arm(), 10 * np.arange(150.0))
    with pytest.raises(InputError, match=r"an arm of 0\.75 m swings once"):
        check_plausible(late, LENGTHS)
    with pytest.raises(InputError, match="an arm of usual length swings once"):
        check_plausible(replace(late, length_unit="body length"), (0.5, 0.5))


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e3, "look like ms: pass --units ms"),
        (1e6, "look like us"),
        (1e9, "look like ns"),
        (RATE, "look like frame numbers: pass --units frames"),
        (1 / 86400, "look like days"),
        (1 / 60, "moves too fast"),
    ],
)
def test_times_in_another_unit_are_refused_with_its_name(factor, words):
    wrong = timed(arm(), np.round(arm().time * factor, 12))
    with pytest.raises(InputError, match=words):
        check_plausible(wrong, LENGTHS)
    check_plausible(replace(wrong, units=parse_units("s")), LENGTHS)  # who says so is believed


def test_seconds_since_1970_are_fine_and_too_few_digits_are_not():
    check_plausible(timed(arm(), arm().time + 1.7e9), LENGTHS)
    with pytest.raises(InputError, match="too few digits"):
        check_plausible(timed(arm(), 1e14 + arm().time), LENGTHS)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("min", 1 / 60), ("frames", RATE)])
def test_units_of_time_are_converted(tmp_path, unit, factor):
    rows = [f"{float(t * factor)!r},{x},{y}" for t, (x, y) in zip(arm().time, arm().keypoints[:, 1], strict=True)]
    (tmp_path / "rec.csv").write_text("time,wrist_x,wrist_y\n" + "\n".join(rows) + "\n")
    fps = RATE if unit == "frames" else None
    recording = load(tmp_path / "rec.csv", units=unit, fps=fps)
    np.testing.assert_allclose(recording.time, arm().time, atol=1e-12)
    if unit == "frames":
        with pytest.raises(InputError, match="needs the frame rate: pass --fps"):
            load(tmp_path / "rec.csv", units=unit)


@pytest.mark.parametrize("amplitude", [0.15, 0.35, 0.8])
def test_degrees_within_50_are_told_by_speeds(amplitude):
    recording = arm(amplitude=amplitude, frequency=0.6, encoders=True, keypoints=False)
    check_plausible(recording, LENGTHS)
    degrees = Recording(
        recording.time, recording.keypoints, (), angles=np.rad2deg(recording.angles), joint_names=recording.joint_names
    )
    assert np.abs(degrees.angles).max() < 50
    with pytest.raises(InputError, match="look like degrees: pass --units deg"):
        check_plausible(degrees, LENGTHS)
    check_plausible(replace(degrees, units=parse_units("rad")), LENGTHS)


def test_slow_degrees_are_told_by_keypoints():
    slow = arm(amplitude=0.3, frequency=0.02, encoders=True)
    angles = slow.angles + np.array([0.8, 0.4])
    direction = np.cumsum(angles, axis=-1)
    steps = np.array(LENGTHS)[:, None] * np.stack([np.cos(direction), np.sin(direction)], -1)

    def both(angles):
        return Recording(
            slow.time, np.cumsum(steps, axis=1), slow.keypoint_names, angles=angles, joint_names=slow.joint_names
        )

    check_plausible(both(angles), LENGTHS)
    check_plausible(both(angles + 0.3), LENGTHS)  # a wrong zero is no unit
    with pytest.raises(InputError, match="taken as deg they fit: pass --units deg"):
        check_plausible(both(np.rad2deg(angles)), LENGTHS)
    with pytest.raises(InputError, match="taken as rad they fit: pass --units rad"):
        check_plausible(replace(both(np.deg2rad(angles)), units=parse_units("deg")), LENGTHS)


def test_body_lengths_need_a_body_of_length_1():
    recording = arm().scaled(1 / sum(LENGTHS), "body length")
    check_plausible(recording, np.array(LENGTHS) / sum(LENGTHS))
    with pytest.raises(InputError, match=r"keypoints are in body lengths, .* this body's links are 0.75 long"):
        check_plausible(recording, LENGTHS)


def test_a_gap_is_bridged_by_empty_rows_with_commands_held():
    recording = arm(60, encoders=True)
    time = recording.time + np.where(np.arange(60) >= 20, 0.8, 0.0)
    commands = np.arange(120.0).reshape(60, 2)
    recording = Recording(
        time,
        recording.keypoints,
        recording.keypoint_names,
        np.full((60, 2), 0.9),
        recording.angles,
        commands,
        recording.joint_names,
    )
    with pytest.warns(UserWarning, match="rows 20 and 21 are 0.82 s apart .* bridged by 40 rows"):
        filled = bridged(recording, sum(LENGTHS))
    assert filled.num_frames == 100
    np.testing.assert_allclose(np.diff(filled.time), 1 / RATE, atol=1e-12)
    own = np.r_[0:20, 60:100]
    np.testing.assert_array_equal(filled.at(own).keypoints, recording.keypoints)
    np.testing.assert_array_equal(filled.torques[20:60], np.tile(commands[19], (40, 1)))
    for values in (filled.keypoints, filled.angles, filled.confidence):
        assert np.isnan(values[20:60]).all()
    short = timed(arm(60), arm(60).time + np.where(np.arange(60) >= 20, 0.2, 0.0))
    assert bridged(short, sum(LENGTHS)) is short


def test_a_gap_of_hours_is_refused_with_what_to_do():
    time = arm(60).time + np.where(np.arange(60) >= 25, 7200.0, 0.0)
    with pytest.raises(
        InputError, match=r"rows 25 and 26 are 7.2e\+03 s apart .* \(--frames :25\) or after it \(--frames 25:\)"
    ):
        bridged(timed(arm(60), time), sum(LENGTHS))
    with pytest.raises(InputError, match=r"\(--frames :125\) or .* \(--frames 125:\)"):  # of rows 100:160 of a file
        bridged(timed(arm(60), time), sum(LENGTHS), first=100)


BODIES = {"dfki": (0.3, 0.2), "ibm": (0.091, 0.070)}


@pytest.mark.parametrize("name", names())
def test_real_recordings_are_plausible(name, data_folder):
    recording = load(name)
    recording = in_body_lengths(recording) if recording.length_unit == "px" else recording
    lengths = BODIES.get(name.split("-")[0], (0.5, 0.5))
    check_plausible(recording, lengths)
    assert bridged(recording, sum(lengths)) is recording
