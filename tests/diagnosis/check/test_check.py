"""A log of MuJoCo's arm with one thing wrong with it, and what is said of it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from robot_log import ARM, robot_log
from servo_log import SERVO_ARM, write_mapping, write_servo_log

from invdyn.diagnosis.check.check import check
from invdyn.diagnosis.check.mistakes import Mistake, _order
from invdyn.inputs import read_logs
from invdyn.models import Link, planar_body
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.recordings import InputError, Recording, write_table
from invdyn.simulate import random_arm, record


@pytest.fixture(scope="module")
def log() -> Recording:
    return robot_log(3.0, camera=False).at(slice(None, None, 4))


def exchanged(values: np.ndarray) -> np.ndarray:
    return values[:, ::-1]


MISTAKES = {
    "torque sign": (lambda log: replace(log, torques=log.torques * [1, -1]), ("elbow",), -1),
    "direction": (lambda log: replace(log, angles=log.angles * [1, -1], torques=log.torques * [1, -1]), ("elbow",), -1),
    "zero": (lambda log: replace(log, angles=np.add(log.angles, [0.6, 0])), ("shoulder",), 0.6),
    "degrees": (lambda log: replace(log, angles=np.degrees(log.angles)), (), np.pi / 180),
    "time": (lambda log: replace(log, time=1e3 * log.time), (), 1e-3),
    "exchanged": (
        lambda log: replace(log, angles=exchanged(log.angles), torques=exchanged(log.torques)),
        ("shoulder", "elbow"),
        0,
    ),
    "scale": (lambda log: replace(log, torques=log.torques / [50, 1]), ("shoulder",), 50),
    "offset": (lambda log: replace(log, torques=np.add(log.torques, [0, 0.6])), ("elbow",), 0.6),
}


@pytest.mark.quick("scale", "direction", "time", "degrees", "zero")
@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_found_with_its_joint_and_size(log, kind):
    spoil, joints, value = MISTAKES[kind]
    found = check(spoil(log), ARM, effects=False).mistakes
    assert [(wrong.kind, wrong.joints) for wrong in found] == [(kind, joints)]
    # friction and masses that are left free, and the window, blur a number by a few per cent
    assert found[0].value == pytest.approx(value, rel=0.1, abs=1e-9)
    assert found[0].remedy in found[0].sentence


def test_of_mistakes_that_are_alike_the_one_without_a_number_comes_first():
    """Angles and torques of a pendulum that count the other way are those of one whose zero is half a turn off."""
    link = Link("rod", "base", "tip", 0.3, 1.2)
    time = np.arange(0, 4, 0.01)
    q = 0.8 * np.sin(2.1 * time) + 0.4 * np.sin(5.3 * time + 1) - 1.2
    qdd = -0.8 * 2.1**2 * np.sin(2.1 * time) - 0.4 * 5.3**2 * np.sin(5.3 * time + 1)
    torque = 1.2 * 0.3**2 / 3 * qdd + 1.2 * 9.81 * 0.15 * np.cos(q)
    angles, torques = -q[:, None], -torque[:, None]
    pendulum = planar_body("pendulum", [link], gravity=(0.0, -9.81))
    log = Recording(time, np.empty((len(time), 0, 2)), (), angles=angles, torques=torques, joint_names=("base",))
    (wrong,) = check(log, pendulum, effects=False).mistakes
    assert wrong.kind == "direction"
    assert any("zero is" in other and "180" in other for other in wrong.others)


def test_two_mistakes_are_found_one_after_the_other(log):
    both = replace(log, angles=np.degrees(log.angles), torques=log.torques * [1, -1])
    found = check(both, ARM, effects=False).mistakes
    assert {wrong.kind for wrong in found} == {"degrees", "torque sign"}


@pytest.mark.parametrize("damping", [0.0, 0.4])
def test_a_log_that_is_right_has_none_though_the_arm_has_friction(damping):
    found = check(robot_log(3.0, (damping, damping), camera=False).at(slice(None, None, 4)), ARM, effects=False)
    assert not found.mistakes
    assert found.unexplained < 0.08


def test_base_parameters_of_a_planar_pair(log):
    """In a plane two links have m₁, and whatever stands beside l₁: the elbow's load turns with the upper arm."""
    base = check(log, ARM, effects=False).excited
    names = [name for each in base for name in each.parts]
    # a first link's mass at its own joint moves nothing
    assert "mass of upper" not in names
    first = next(
        each
        for each in base
        if "first moment of upper" in next(iter(each.parts)) or "first moment of upper" in each.parts
    )
    # m₁ c₁ + m₂ l₁, whichever of the two is called the base
    ratio = first.parts.get("mass of fore", 1.0) / first.parts.get("first moment of upper", 1.0)
    assert ratio == pytest.approx(ARM.links[0].length, rel=1e-6)
    known = {name for each in base if each.sd < 0.05 * abs(each.value) for name in each.parts}
    assert {"first moment of upper", "first moment of fore"} <= known


def test_effects_that_would_show_and_what_to_record(log):
    shown = check(log.select(0, 150), ARM).visible
    assert shown.dprime["viscous_friction.elbow"] > 3
    assert all(shown.dprime[name] < 3 for name in shown.hidden)
    assert {name for of in shown.record.values() for name in of} == set(shown.hidden)


def test_joints_of_another_robot_are_refused(log):
    with pytest.raises(InputError, match="expected torques of every joint"):
        check(replace(log, joint_names=("a", "b")), ARM)


def test_exchanged_angles_of_a_servo_are_found_about_the_joints_own_zeros(tmp_path):
    """The shoulder counts from hanging down, and its servo would answer to the other joint's angle."""
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml", columns=("q2", "q1"))
    (reading,) = read_logs(str(tmp_path / "log.csv"), SERVO_ARM, str(tmp_path / "map.toml"))
    (wrong,) = check(reading, SERVO_ARM, effects=False).mistakes
    assert (wrong.kind, wrong.words) == ("exchanged", "the angles are exchanged")
    assert wrong.after < 0.1


def mapped(folder, log, sign, zero, tracks="12"):
    """A log whose shoulder counts clockwise from half a radian, as a mapping with ``sign`` and ``zero`` reads it."""
    one, two = tracks
    own = {"q1": 0.5 - log.angles[:, 0], "u1": -log.torques[:, 0], "q2": log.angles[:, 1], "u2": log.torques[:, 1]}
    write_table({"t": log.time, **own}, folder / "log.csv")
    (folder / "map.toml").write_text(
        f'time = "t"\n[joints.shoulder]\nangle = {{track = "q{one}", sign = {sign}, zero = {zero}}}\n'
        f'torque = {{track = "u{one}", sign = {sign}}}\n[joints.elbow]\nangle = "q{two}"\ntorque = "u{two}"\n'
    )
    return read_logs(str(folder / "log.csv"), ARM, str(folder / "map.toml"))[0]


def test_a_sign_of_a_mapping_is_wrong_about_its_zero(log, tmp_path):
    assert not check(mapped(tmp_path, log, -1, 0.5), ARM, effects=False).mistakes
    (wrong,) = check(mapped(tmp_path, log, 1, 0.5), ARM, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == ("direction", ("shoulder",))
    assert wrong.after < 0.05


def test_exchanged_columns_of_a_mapping_leave_signs_and_zeros_where_they_are(log, tmp_path):
    (wrong,) = check(mapped(tmp_path, log, -1, 0.5, "21"), ARM, effects=False).mistakes
    assert (wrong.kind, wrong.words) == ("exchanged", "the columns are exchanged")
    assert wrong.after < 0.05


def test_of_mistakes_that_mirror_each_other_that_nearer_the_base_is_said_first():
    """Their misfits differ in the last digit alone; one that is better by more comes first, wherever it is."""
    base, tip = (Mistake("direction", (k,), "", "", -1.0, lambda motion: motion) for k in range(2))
    assert min([(0.1 - 1e-15, tip), (0.1, base)], key=partial(_order, False))[1] is base
    assert min([(0.1 - 1e-3, tip), (0.1, base)], key=partial(_order, False))[1] is tip


def test_a_sign_of_a_servo_is_wrong_about_the_zero_of_its_file(tmp_path):
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml")
    turned = (tmp_path / "map.toml").read_text().replace('"q1", ', '"q1", sign = -1, ')
    (tmp_path / "map.toml").write_text(turned.replace('"target1", ', '"target1", sign = -1, '))
    (reading,) = read_logs(str(tmp_path / "log.csv"), SERVO_ARM, str(tmp_path / "map.toml"))
    (wrong,) = check(reading, SERVO_ARM, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == ("direction", ("shoulder",))
    assert wrong.others == ("at elbow angles and torques are counted the other way (clockwise)",)  # its mirror image
    assert wrong.after < 0.1


def test_a_zero_of_a_mapping_is_said_as_the_robot_counts(log, tmp_path):
    """Its file turns the joint the other way: 0.6 too much in the mapping is 0.6 too little of ours."""
    clockwise = replace(ARM, links=(replace(ARM.links[0], parts=JointParts().turned(-1, 0.0)), ARM.links[1]))
    reading = mapped(tmp_path, replace(log, angles=log.angles * [-1, 1], torques=log.torques * [-1, 1]), -1, 1.1)
    turned = replace(reading.recording, angles=reading.recording.angles * [-1, 1])
    own = read_logs(str(tmp_path / "log.csv"), clockwise, str(tmp_path / "map.toml"))[0]
    np.testing.assert_allclose(own.recording.angles, turned.angles)
    (wrong,) = check(own, clockwise, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == ("zero", ("shoulder",))
    assert wrong.value == pytest.approx(0.6, rel=0.1)
    assert wrong.remedy.startswith(f"subtract {wrong.value:.3g} rad")
    assert wrong.remedy.endswith(f"from its zero in {tmp_path / 'map.toml'}")


@pytest.mark.parametrize(
    ("torques", "passive", "why"),
    [
        (None, False, "the log has no torques"),
        (0.0, False, "all torques are zero"),
        (np.nan, False, "torques are missing at some joint or row"),
        (1.0, True, "no torque acts"),
    ],
)
def test_what_could_not_be_looked_at_is_said(log, torques, passive, why):
    given = None if torques is None else np.full_like(log.torques, torques)
    found = check(replace(log, torques=given), ARM, passive=passive, effects=False)
    assert found.not_looked_at == f"signs, zeros, exchanged columns and gears of joints: {why}"
    assert found.to_json()["not_looked_at"] == found.not_looked_at
    assert check(log, ARM, effects=False).not_looked_at is None


def test_torques_of_a_motion_that_was_seen_too_seldom_lack_no_gear():
    """With the elbow's a thousand times as large, whatever the shoulder's miss would not count."""
    arm = random_arm(ARM, duration=2.0, fps=30, noise=0.002, torque_scale=0.5, commanded=True, seed=1)
    found = check(record(arm, 1)[0], ARM, effects=False)
    assert found.unexplained > 0.2
    assert "scale" not in {wrong.kind for wrong in found.mistakes}


def test_torques_that_nothing_explains_are_not_called_right(log):
    noise = np.random.default_rng(0).normal(0, 5, log.torques.shape)
    found = check(replace(log, torques=noise), ARM, effects=False)
    assert not found.mistakes
    assert found.unclear
    assert not check(log, ARM, effects=False).unclear


def test_a_servo_whose_log_has_no_torque_is_told_of_its_targets(tmp_path):
    """A twentieth of a radian is two newton-metres, which no column of the log has."""
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml")
    (reading,) = read_logs(str(tmp_path / "log.csv"), SERVO_ARM, str(tmp_path / "map.toml"))
    off = replace(reading.recording, angles=np.add(reading.recording.angles, [0.1, 0]))
    (wrong,) = check(replace(reading, recording=off), SERVO_ARM, effects=False).mistakes
    assert (wrong.kind, wrong.joints) == ("offset", ("shoulder",))
    assert wrong.words.startswith("the servo's targets are -0.1")
    assert "N·m" not in wrong.sentence
    assert "from its targets, or 0.1" in wrong.remedy
