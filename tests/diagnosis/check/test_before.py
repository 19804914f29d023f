"""What is refused before a diagnosis, what is only said, and what goes by in silence."""

import importlib
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from robot_log import ARM, robot_log
from servo_log import SERVO_ARM, write_mapping, write_servo_log
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.diagnosis.check.before import check_before
from invdyn.diagnosis.check.check import Check, Wrong
from invdyn.diagnosis.check.units import wrong_units
from invdyn.recordings import InputError, write_keypoint_csv
from invdyn.recordings.reading import Reading


@pytest.fixture(scope="module")
def log():
    return robot_log(3.0, camera=False).at(slice(None, None, 4))


@pytest.mark.quick("*sign", "*deg", "*ms")
@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (lambda log: {"time": 1e3 * log.time}, "the times are in milliseconds, it seems: pass --units ms"),
        (lambda log: {"angles": np.degrees(log.angles)}, "the angles are in degrees, it seems: pass --units deg"),
        (lambda log: {"angles": log.angles[:, ::-1]}, "'shoulder' and 'elbow' the angles are exchanged"),
        (lambda log: {"torques": log.torques * [1, -1]}, "'elbow' the torques have the other sign"),
        (lambda log: {"torques": log.torques / [10, 1]}, "'shoulder' the torques are .* too small: before the gear"),
        (lambda log: {"torques": log.torques * 1000}, "1e\\+03 times too large: in another unit"),
        (lambda log: {"angles": np.add(log.angles, [0.6, 0])}, r"'shoulder' the angles' zero is \+3.° off"),
        (lambda log: {"angles": np.add(log.angles, [0, 0.6])}, r"'elbow' the angles' zero is \+3.° off"),
    ],
)
def test_what_no_effect_looks_like_is_refused(log, changed, says):
    with pytest.raises(InputError, match=says):
        check_before(Reading(replace(log, **changed(log))), ARM)


@pytest.mark.quick("*tilted")
@pytest.mark.parametrize(
    ("changed", "says"),
    [
        (lambda log: {"torques": log.torques * [5, 1]}, "too large.*, unless it is a motor at its limit"),
        (lambda log: {"angles": np.add(log.angles, [0.4, 0])}, "unless it is gravity that is tilted"),
        (
            lambda log: {"torques": np.add(log.torques, [0, 0.6])},
            "unless it is a spring's torque, a stop's, or a shifted marker",
        ),
    ],
)
def test_what_an_effect_looks_like_is_said_and_goes_on(log, changed, says):
    with pytest.warns(UserWarning, match=says):
        check_before(Reading(replace(log, **changed(log))), ARM)


def test_what_comes_after_a_first_mistake_is_said_and_never_refused(log, monkeypatch):
    """If the first is an effect, nobody knows that the second is a mistake."""
    first = Wrong("offset", ("elbow",), "the torques are off", "subtract it", 0.6, 0.9, 0.1)
    second = Wrong("torque sign", ("shoulder",), "the torques have the other sign", "change it", -1.0, 0.9, 0.01)
    monkeypatch.setattr(
        sys.modules[check_before.__module__],
        "check",
        lambda *_, **__: Check("log", (first, second), 0.01, {}, (), None),
    )
    with pytest.warns(UserWarning, match="says more") as told:
        check_before(log, ARM)
    off, turned = (str(each.message) for each in told)
    assert "'elbow' the torques are off" in off
    assert "then at joint 'shoulder' the torques have the other sign" in turned


def test_torques_that_nothing_explains_are_told_of(log):
    """`invdyn check` calls such a log unclear; a diagnosis goes on, for an effect may be what it is."""
    noise = np.random.default_rng(0).normal(size=log.torques.shape)
    with pytest.warns(UserWarning, match="the torques miss .* % of their size, and no sign"):
        check_before(Reading(replace(log, torques=noise)), ARM)


@pytest.mark.parametrize("factor", [200.0, 500.0])
def test_a_factor_that_no_gear_has_is_not_sure(log, monkeypatch, factor):
    wrong = Wrong("scale", ("shoulder",), "too small", "multiply", factor, 0.9, 0.01)
    said = Check("log", (wrong,), 0.01, {}, (), None)
    monkeypatch.setattr(sys.modules[check_before.__module__], "check", lambda *_, **__: said)
    refused = pytest.raises(InputError, match="too small")
    with refused if factor < 300 else pytest.warns(UserWarning, match="too small"):
        check_before(log, ARM)


@pytest.mark.parametrize(("friction", "masses"), [(0.0, (1.5, 1.0)), (0.4, (1.5, 1.0)), (0.0, (1.2, 1.3))])
def test_a_log_that_is_right_goes_by_whatever_its_arm_has(friction, masses):
    log = robot_log(3.0, (friction, friction), camera=False).at(slice(None, None, 4))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_before(Reading(log), ARM.with_values(mass=list(masses)))
        check_before(Reading(replace(log, torques=-log.torques)), ARM, passive=True)


def test_a_recording_is_in_si_units_by_its_own_account():
    """A film that is ten times too fast is told of, and refused where somebody may say the unit."""
    film = robot_log(1.0)
    fast = replace(film, time=0.1 * film.time, angles=None, torques=None, joint_names=())
    with pytest.warns(UserWarning, match="too fast"):
        check_before(fast, ARM)
    with pytest.raises(InputError, match="too fast"):
        check_before(Reading(fast), ARM)


def diagnosed(folder, name, *options):
    given = (folder / name, "--body", folder / "arm.toml", "--out", folder / "out", *options)
    return CliRunner().invoke(app, ["diagnose", *map(str, given)])


def test_the_command_asks_first(tmp_path, log):
    ARM.to_toml(tmp_path / "arm.toml")
    write_keypoint_csv(replace(log, angles=log.angles[:, ::-1]), tmp_path / "log.csv")
    refused = diagnosed(tmp_path, "log.csv")
    assert refused.exit_code == 2
    assert "the angles are exchanged" in refused.output
    write_keypoint_csv(log, tmp_path / "right.csv")
    refused = diagnosed(tmp_path, "right.csv", "--held-out", tmp_path / "log.csv")
    assert "the angles are exchanged" in refused.output


@pytest.mark.parametrize("option", ["--fps 100", "--scale .01", "--set base=hip", "--scale body"])
def test_a_log_takes_no_option_of_keypoints(option, tmp_path):
    SERVO_ARM.to_toml(tmp_path / "arm.toml")
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml")
    refused = diagnosed(tmp_path, "log.csv", "--map", tmp_path / "map.toml", *option.split())
    assert refused.exit_code == 2
    name = "--set base" if "base" in option else option.split()[0]
    assert f"leave {name} out" in refused.output


def test_the_command_asks_a_log_first(tmp_path):
    SERVO_ARM.to_toml(tmp_path / "arm.toml")
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml", columns=("q2", "q1"))
    refused = diagnosed(tmp_path, "log.csv", "--map", tmp_path / "map.toml")
    assert refused.exit_code == 2
    assert "the angles are exchanged" in refused.output


@pytest.mark.parametrize("command", ["check", "diagnose"])
def test_units_are_asked_for_once_and_by_one_function(tmp_path, monkeypatch, command):
    """`check`, and `diagnose` before it begins: one question a log, by the same function."""
    asking = sys.modules["invdyn.diagnosis.check.check"]
    diagnosing = importlib.import_module("invdyn.diagnosis.diagnose")
    asked, begun = [], []

    def counted(reading, body, rules):
        asked.append(reading.recording.name)
        return wrong_units(reading, body, rules)

    def begins(*_, checked=False, **__):
        begun.append(checked)  # else it would ask once more
        raise InputError("far enough")

    monkeypatch.setattr(asking, "wrong_units", counted)
    monkeypatch.setattr(diagnosing, "diagnose", begins)
    SERVO_ARM.to_toml(tmp_path / "arm.toml")
    for name in ("log", "other"):
        write_servo_log(tmp_path / f"{name}.csv")
    write_mapping(tmp_path / "map.toml")
    mapped = ("--map", tmp_path / "map.toml")
    if command == "check":
        given = (command, tmp_path / "arm.toml", tmp_path / "log.csv", *mapped, "--no-effects")
        assert CliRunner().invoke(app, list(map(str, given))).exit_code == 0
        assert asked == ["log"]
    else:
        stopped = diagnosed(tmp_path, "log.csv", *mapped, "--held-out", tmp_path / "other.csv")
        assert "far enough" in stopped.output
        assert asked == ["log", "other"]
        assert begun == [True]


def test_what_is_refused_is_printed_and_passed_by_force(log):
    """The option, and the same in Python; what is said is what would have been refused."""
    wrong = replace(log, torques=log.torques * [1, -1])
    with pytest.warns(UserWarning, match=r"'elbow' the torques have the other sign.* continued, by --force"):
        (said,) = check_before(Reading(wrong), ARM, force=True)
    assert "the torques have the other sign" in said
    assert check_before(Reading(log), ARM, force=True) == ()
    with pytest.warns(UserWarning, match="are in degrees, it seems.* continued, by --force"):
        check_before(Reading(replace(log, angles=np.degrees(log.angles))), ARM, force=True)


@pytest.mark.long
def test_the_option_goes_past_a_refusal(tmp_path, log, monkeypatch):
    def begins(*_, **given):
        raise InputError(f"begun by force: {given['force']}, past {len(given['refused'])} refusal")

    monkeypatch.setattr(importlib.import_module("invdyn.diagnosis.diagnose"), "diagnose", begins)
    ARM.to_toml(tmp_path / "arm.toml")
    write_keypoint_csv(replace(log, angles=log.angles[:, ::-1]), tmp_path / "log.csv")
    assert "begun" not in diagnosed(tmp_path, "log.csv").output
    with warnings.catch_warnings():
        warnings.simplefilter("always")  # the command prints them
        passed = diagnosed(tmp_path, "log.csv", "--force").output
    assert "the angles are exchanged" in passed
    assert "continued, by --force" in passed
    assert "begun by force: True" in passed


def test_a_doubt_is_a_warning(log, monkeypatch):
    module = importlib.import_module("invdyn.diagnosis.check.check")
    monkeypatch.setattr(module, "doubted_degrees", lambda *_: "they may be shares")
    with pytest.warns(UserWarning, match="they may be shares"):
        assert check_before(Reading(log), ARM) == ()
