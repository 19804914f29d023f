"""Units that a mapping has wrong: named with the line to change, put right there, and nothing false beside them."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from robot_log import ARM, robot_log
from servo_log import SERVO_ARM, write_mapping, write_servo_log

from invdyn.diagnosis.check.before import check_before
from invdyn.diagnosis.check.check import check
from invdyn.diagnosis.check.units import wrong_units
from invdyn.inputs import read_logs
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording
from invdyn.recordings.reading import Reading
from invdyn.recordings.units import parse_units

WRONG = {
    "times": ({"time": ""}, "the times are in milliseconds", 'write time_unit = "ms" in {map}'),
    "angles": ({"angle": ""}, "the angles are in degrees", 'write unit = "deg" in each line "angle = …" of {map}'),
    "angles and targets": (
        {"angle": "", "target": ""},
        "the angles and the servos' targets are in degrees",
        'write unit = "deg" in each line "angle = …" and "target = …" of {map}',
    ),
    # what was said is believed unless the torques contradict it
    "what was said": (
        {"angle": "rad", "target": "rad"},
        "the angles and the servos' targets are in degrees",
        'write unit = "deg" in each line "angle = …" and "target = …" of {map}',
    ),
}


@pytest.fixture
def log(tmp_path):
    write_servo_log(tmp_path / "log.csv")
    return tmp_path / "log.csv"


def read(log, **units):
    write_mapping(log.parent / "map.toml", **units)
    (reading,) = read_logs(str(log), SERVO_ARM, str(log.parent / "map.toml"))
    return reading


def test_a_mapping_that_is_right_has_no_mistake(log):
    reading = read(log)
    check_before(reading, SERVO_ARM)
    assert not check(reading, SERVO_ARM, effects=False).mistakes


@pytest.mark.parametrize("case", WRONG)
def test_the_line_to_change_is_named_and_nothing_else_is_found(log, case):
    units, words, remedy = WRONG[case]
    remedy = remedy.format(map=log.parent / "map.toml")
    reading = read(log, **units)
    (wrong,) = check(reading, SERVO_ARM, effects=False).mistakes
    assert (wrong.words, wrong.remedy) == (words, remedy)
    with pytest.raises(InputError) as refused:
        check_before(reading, SERVO_ARM)
    assert f"log: {words}, it seems: {remedy}" in str(refused.value)
    right = read(log).recording
    righted = reading.rescaled(**{"time": 1e-3} if "times" in words else {"angle": np.pi / 180}).recording
    np.testing.assert_allclose(righted.angles, right.angles)
    np.testing.assert_allclose(righted.time, right.time)


def test_times_in_another_unit_than_was_said_are_named_by_their_own(log):
    (wrong,) = check(read(log, time='time_unit = "us"'), SERVO_ARM, effects=False).mistakes
    assert wrong.words == "the times are in milliseconds"
    assert wrong.remedy.startswith('write time_unit = "ms" in ')


def test_targets_alone_in_another_unit_are_named(log):
    (wrong,) = check(read(log, target="rad"), SERVO_ARM, effects=False).mistakes
    assert wrong.words == "the servos' targets are in degrees"
    assert wrong.remedy.startswith('write unit = "deg" in each line "target = …" of ')
    assert wrong.after < 0.1


def test_times_and_angles_that_are_both_wrong_are_both_named(log):
    kinds = [wrong.kind for wrong in check(read(log, time="", angle="", target=""), SERVO_ARM, effects=False).mistakes]
    assert sorted(kinds) == ["degrees", "time"]


def test_what_was_declared_is_believed_where_nothing_but_its_size_speaks_against_it():
    """A rotor that turns a hundred times is no arm in degrees, if somebody says so and no torque contradicts it."""
    rotor = planar_body("rotor", [Link("disc", "axle", "rim", 0.1, 1.0)], gravity=(0.0, 0.0))
    time = np.arange(0, 4, 0.01)
    turning = Recording(time, np.empty((len(time), 0, 2)), (), angles=150 * time[:, None], joint_names=("axle",))
    check_before(Reading(replace(turning, units=parse_units("rad"))), rotor)
    with pytest.raises(InputError, match="the angles are in degrees, it seems: pass --units deg"):
        check_before(Reading(turning), rotor)
    # spinning up by a torque that is asked for in radians
    spun = replace(turning, angles=(40 * time**2)[:, None], torques=np.full((len(time), 1), 80 * 0.01 / 3))
    spun = replace(spun, units=parse_units("rad"))
    check_before(Reading(spun), rotor)
    check_before(Reading(spun), rotor)
    assert not check(Reading(spun), rotor, effects=False).mistakes


def test_one_mistake_comes_before_two_that_fit_better(monkeypatch):
    """Angles that are small enough may be in degrees as well, and an arm that lacks something fits anything."""
    missed = iter(np.linspace(1, 0, 100))
    monkeypatch.setattr(sys.modules[wrong_units.__module__], "least_misfit", lambda *_: next(missed))
    log = robot_log(1.0, camera=False)
    _, mistakes, righted = wrong_units(Reading(replace(log, time=1e3 * log.time)), ARM)
    assert [mistake.kind for mistake in mistakes] == ["time"]
    assert righted.recording.time == pytest.approx(log.time)
