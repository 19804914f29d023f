"""Remedies that are named: of columns that the log has, not in its mapping yet, that bring a joint's torques down."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from robot_log import ARM, robot_log
from servo_log import SERVO, SERVO_ARM, ZERO, write_servo_log

from invdyn.diagnosis.check.check import check
from invdyn.diagnosis.check.units import doubted_degrees
from invdyn.diagnosis.rules import DEFAULT
from invdyn.inputs import read_logs
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.recordings import InputError, write_table
from invdyn.recordings.tables import read_table

GEAR = -3.0
GEARED = replace(
    SERVO_ARM,
    links=(
        replace(ARM.links[0], parts=JointParts(motor=replace(SERVO, gear=GEAR)).turned(1, ZERO)),
        ARM.links[1],
    ),
)
RANGES = {"q1": (-1.9, 2.4), "q2": (-1.2, 1.6)}
"""rad, in which the columns q1 and q2 are -100 to 100, as LeRobot has them."""


def written(folder: Path, lines: str, change=lambda columns: columns) -> str:
    """A log with its columns changed, and a mapping with these ``lines`` of the shoulder and the elbow."""
    write_servo_log(folder / "plain.csv")
    columns, _ = read_table(folder / "plain.csv")
    write_table(change(dict(columns)), folder / "log.csv")
    (folder / "map.toml").write_text(f'time = "t"\ntime_unit = "ms"\n{lines}')
    return str(folder / "log.csv")


def checked(folder: Path, body, lines: str, change=lambda columns: columns):
    (reading,) = read_logs(written(folder, lines, change), body, str(folder / "map.toml"))
    return check(reading, body, effects=False)


def servo(keys: str = "", unit: str = 'unit = "deg"') -> str:
    return (
        f'[joints.shoulder]\nangle = {{track = "q1", {unit}}}\ntarget = {{track = "target1", {unit}{keys}}}\n'
        f'[joints.elbow]\nangle = {{track = "q2", {unit}}}\ntorque = "tau2"\n'
    )


def at_the_actuator(columns: dict) -> dict:
    return columns | {"target1": GEAR * columns["target1"]}


def test_targets_at_the_actuator_are_given_the_gear_of_the_file(tmp_path):
    """MuJoCo's ctrl; no torque of the shoulder was logged, so that nothing is said of it."""
    (wrong,) = checked(tmp_path, GEARED, servo(), at_the_actuator).mistakes
    assert (wrong.kind, wrong.joints, wrong.value) == ("gear", ("shoulder",), GEAR)
    assert f'write gear = {GEAR:g} in the line "target = …"' in wrong.remedy
    assert "torques have" not in wrong.sentence
    assert not checked(tmp_path, GEARED, servo(f", gear = {GEAR}"), at_the_actuator).mistakes


def test_a_gear_that_a_mapping_has_is_not_named_again(tmp_path):
    assert not checked(tmp_path, GEARED, servo()).mistakes
    (wrong,) = checked(tmp_path, GEARED, servo(f", gear = {GEAR}")).mistakes
    assert (wrong.kind, wrong.value) == ("gear", 1.0)
    assert "counted at the joint" in wrong.words


def test_of_a_servo_it_is_the_target_that_has_a_sign_and_not_the_torque(tmp_path):
    (wrong,) = checked(tmp_path, SERVO_ARM, servo(", sign = -1")).mistakes
    assert (wrong.kind, wrong.words) == ("torque sign", "the servos' targets have the other sign")
    assert wrong.remedy == "change the sign of its servos' targets"


def test_of_a_servo_it_is_the_target_that_is_too_large(tmp_path):
    found = checked(tmp_path, SERVO_ARM, servo(), lambda columns: columns | {"target1": 5 * columns["target1"]})
    (wrong,) = found.mistakes
    assert wrong.words.startswith("the servos' targets are ")
    assert wrong.value == pytest.approx(0.2, rel=0.1)


@pytest.mark.quick("rad")
@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_a_unit_that_a_mapping_has_is_not_named_again(tmp_path, unit):
    """Numbers far too large even in the unit that stands there."""

    def large(columns: dict) -> dict:
        return columns | {name: 1e3 * columns[name] for name in ("q1", "q2", "target1")}

    found = checked(tmp_path, SERVO_ARM, servo(unit=f'unit = "{unit}"'), large)
    assert found.mistakes or found.unclear
    assert not any(f'unit = "{unit}"' in wrong.remedy for wrong in found.mistakes)


def in_range(columns: dict, cut: float = np.inf) -> dict:
    """Angles and targets in per cent of their ranges, cut at ``cut``."""

    def percent(name: str, of: str) -> np.ndarray:
        low, high = RANGES[of]
        return np.clip(-100 + 200 * (np.radians(columns[name]) - low) / (high - low), -cut, cut)

    return columns | {"q1": percent("q1", "q1"), "q2": percent("q2", "q2"), "target1": percent("target1", "q1")}


def test_numbers_within_a_hundred_may_be_shares_of_a_range(tmp_path):
    """Degrees alone are never proposed, and nothing is looked for in angles that are not known."""
    found = checked(tmp_path, SERVO_ARM, servo(unit="sign = 1"), in_range)
    (wrong,) = found.mistakes
    assert wrong.kind == "percent"
    assert wrong.remedy.startswith("write range = [low, high], rad at −100 and at 100, ")
    assert found.not_looked_at.endswith("the unit of the angles is not known")


def test_numbers_that_end_at_a_hundred_are_no_degrees(tmp_path):
    (wrong,) = checked(
        tmp_path,
        SERVO_ARM,
        servo(unit="sign = 1"),
        lambda columns: in_range({**columns, "q1": columns["q1"] * 3}, 100.0),
    ).mistakes
    assert wrong.kind == "percent"
    assert "deg" not in wrong.sentence


@pytest.mark.parametrize(
    ("unit", "factor", "misfit", "doubted"),
    [("deg", 1, 0.17, True), ("deg", 1, 0.05, False), ("deg", 20, 0.17, False), ("rad", 1, 0.17, False)],
)
def test_degrees_that_the_torques_do_not_bear_out_may_be_shares(tmp_path, unit, factor, misfit, doubted):
    """Of a servo's log within ±100, whose torques miss a tenth or more."""
    large = dict.fromkeys(("q1", "q2"), factor)
    log = written(
        tmp_path,
        servo(unit=f'unit = "{unit}"'),
        lambda columns: columns | {name: by * columns[name] for name, by in large.items()},
    )
    (reading,) = read_logs(log, SERVO_ARM, str(tmp_path / "map.toml"))
    found = doubted_degrees(reading, SERVO_ARM, misfit)
    assert (found is not None) == doubted
    if found is not None:
        assert "may be LeRobot's −100 to 100" in found
        assert "write range = [low, high], rad at −100 and at 100, in each line" in found


def test_degrees_that_the_torques_bear_out_are_named(tmp_path):
    (wrong,) = checked(tmp_path, SERVO_ARM, servo(unit="sign = 1")).mistakes
    assert wrong.kind == "degrees"


def test_a_range_is_right(tmp_path):
    lines = "".join(
        f'[joints.{joint}]\nangle = {{track = "{column}", range = {list(RANGES[column])}}}\n{command}\n'
        for joint, column, command in (
            ("shoulder", "q1", f'target = {{track = "target1", range = {list(RANGES["q1"])}}}'),
            ("elbow", "q2", 'torque = "tau2"'),
        )
    )
    found = checked(tmp_path, SERVO_ARM, lines, in_range)
    assert not found.mistakes
    assert found.unexplained == pytest.approx(checked(tmp_path, SERVO_ARM, servo()).unexplained, rel=1e-6)


def test_columns_of_ranges_are_exchanged_as_the_log_has_them(tmp_path):
    """Each joint's range stays with it; what was exchanged is the numbers."""
    lines = "".join(
        f'[joints.{joint}]\nangle = {{track = "{column}", range = {list(RANGES[own])}}}\n{command}\n'
        for joint, column, own, command in (
            ("shoulder", "q2", "q1", f'target = {{track = "target1", range = {list(RANGES["q1"])}}}'),
            ("elbow", "q1", "q2", 'torque = "tau2"'),
        )
    )
    (wrong,) = checked(tmp_path, SERVO_ARM, lines, in_range).mistakes
    assert (wrong.kind, wrong.words) == ("exchanged", "the angles are exchanged")
    assert wrong.after < DEFAULT.check.max_joint_misfit


@pytest.mark.quick("0")
@pytest.mark.parametrize("seed", range(3))
def test_torques_that_have_nothing_to_do_with_the_motion_are_not_said_to_be_too_large(seed):
    """Noise that is made small enough misses little of the other joint's torques, and all of its own."""
    log = robot_log(3.0, camera=False).at(slice(None, None, 4))
    torques = np.array(log.torques)
    torques[:, 1] = np.random.default_rng(seed).normal(0, 20, len(torques))
    found = check(replace(log, torques=torques), ARM, effects=False)
    assert not found.mistakes
    assert found.unclear


def test_a_log_whose_remedies_leave_too_much_is_unclear():
    """It is not called right, though the torques miss less than those of some right logs do."""
    log, rules = robot_log(3.0, camera=False).at(slice(None, None, 4)), DEFAULT.replace(max_joint_misfit=0.0)
    found = check(replace(log, torques=np.add(log.torques, [0, 0.6])), ARM, effects=False, rules=rules)
    assert not found.mistakes
    assert found.unexplained < DEFAULT.check.max_right_misfit
    assert found.unclear


@pytest.mark.quick("50.0-*")
@pytest.mark.parametrize(("factor", "least", "most"), [(50.0, 0.95, 1.0), (0.02, 45.0, 60.0)])
def test_what_is_missed_is_stated_in_terms_of_what_the_motion_asks(factor, least, most):
    """A fiftieth of the torque misses no more than all of it, fifty times as much many times as much."""
    log = robot_log(3.0, camera=False).at(slice(None, None, 4))
    (wrong,) = check(replace(log, torques=log.torques / [factor, 1]), ARM, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == ("scale", ("shoulder",))
    assert least < wrong.before < most
    assert wrong.after < DEFAULT.check.max_joint_misfit


def of_servo(folder: Path, shoulder: str, hide_torque: bool = False):
    """The torques of a log whose shoulder, which has a servo, takes these commands."""
    lines = (
        f'[joints.shoulder]\nangle = {{track = "q1", unit = "deg"}}\n{shoulder}\n'
        '[joints.elbow]\nangle = {track = "q2", unit = "deg"}\ntorque = "tau2"\n'
    )
    log = written(folder, lines)
    (reading,) = read_logs(log, SERVO_ARM, str(folder / "map.toml"), hide_torque=hide_torque)
    return None if reading.recording.torques is None else reading.recording.torques[:, 0]


def test_a_torque_of_a_servo_is_asked_about_and_never_taken_for_a_feed_forward(tmp_path):
    target = 'target = {track = "target1", unit = "deg"}'
    with pytest.raises(InputError, match=r"a torque of joint 'shoulder', which has a servo .*: map the servo's target"):
        of_servo(tmp_path, 'torque = "tau2"')
    assert of_servo(tmp_path, 'torque = "tau2"', hide_torque=True) is None
    with pytest.warns(UserWarning, match="the torque of joint 'shoulder' is not used"):
        plain = of_servo(tmp_path, f'{target}\ntorque = "tau2"')
    np.testing.assert_array_equal(plain, of_servo(tmp_path, target))
    added = of_servo(tmp_path, f'{target}\ntorque = {{track = "tau2", feedforward = true, sign = -1}}')
    columns, _ = read_table(tmp_path / "log.csv")
    np.testing.assert_allclose(added, plain - columns["tau2"])
