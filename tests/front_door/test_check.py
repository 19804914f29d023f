"""`invdyn check`: a sentence for each mistake, exit code 2 with one, a JSON that says the same."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from robot_log import ARM, robot_log
from servo_log import SERVO_ARM, write_mapping, write_servo_log
from typer.testing import CliRunner

from invdyn.cli import app
from invdyn.diagnosis.check.check import Check
from invdyn.models import Body, dynamics_for, load_body
from invdyn.recordings import write_keypoint_csv
from invdyn.robot_commands import check_text


@pytest.fixture
def files(tmp_path):
    """A log and its arm in a folder."""
    log = robot_log(2.0, camera=False).at(slice(None, None, 4))
    ARM.to_toml(tmp_path / "arm.toml")
    write_keypoint_csv(log, tmp_path / "log.csv")
    write_keypoint_csv(replace(log, torques=log.torques * [1, -1]), tmp_path / "wrong.csv")
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(app, ["check", *map(str, arguments)])


def test_what_is_right_and_what_is_wrong(files):
    right = run(files / "arm.toml", files / "log.csv", "--no-effects")
    assert right.exit_code == 0, right.output
    assert "nothing looks wrong" in right.output
    wrong = run(files / "arm.toml", files / "wrong.csv", "--no-effects", "--out", files / "check.json")
    assert wrong.exit_code == 2
    assert "at joint 'elbow' the torques have the other sign" in wrong.output
    said = json.loads((files / "check.json").read_text())
    assert said["mistakes"][0]["kind"] == "torque sign"
    assert said["mistakes"][0]["joints"] == ["elbow"]


def test_the_units_of_a_log_are_put_right_in_its_mapping(tmp_path):
    write_servo_log(tmp_path / "log.csv")
    write_mapping(tmp_path / "map.toml", time="")
    SERVO_ARM.to_toml(tmp_path / "arm.toml")
    mapped = ("--map", tmp_path / "map.toml")
    wrong = run(tmp_path / "arm.toml", tmp_path / "log.csv", *mapped, "--no-effects")
    assert wrong.exit_code == 2
    assert f'the times are in milliseconds: write time_unit = "ms" in {tmp_path / "map.toml"}' in wrong.output
    diagnosing = ("diagnose", tmp_path / "log.csv", "--body", tmp_path / "arm.toml", *mapped, "--out", tmp_path / "out")
    for command in (("check", tmp_path / "arm.toml", tmp_path / "log.csv", *mapped), diagnosing):
        refused = CliRunner().invoke(app, [*map(str, command), "--units", "ms"])
        assert refused.exit_code == 2
        assert "units in its mapping: leave --units out" in refused.output
    refused = CliRunner().invoke(app, list(map(str, diagnosing)))
    assert refused.exit_code == 2
    assert 'the times are in milliseconds, it seems: write time_unit = "ms"' in refused.output


def test_what_could_not_be_looked_at_and_what_is_unclear(files):
    log = robot_log(3.0, camera=False).at(slice(None, None, 4))
    write_keypoint_csv(replace(log, torques=None), files / "silent.csv")
    silent = run(files / "arm.toml", files / "silent.csv", "--no-effects")
    assert silent.exit_code == 0, silent.output
    assert "nothing looks wrong in what could be looked at" in silent.output
    assert "columns and gears of joints: the log has no torques" in silent.output
    write_keypoint_csv(replace(log, torques=np.random.default_rng(0).normal(0, 5, (375, 2))), files / "noise.csv")
    noise = run(files / "arm.toml", files / "noise.csv", "--no-effects")
    assert "unclear    the torques are far from the motion" in noise.output
    assert "nothing looks wrong" not in noise.output


def test_numbers_of_frames_have_a_rate(files):
    """As `infer` and `diagnose` read them; a log that is mapped has its own times."""
    log = (files / "log.csv").read_text().splitlines()
    rows = [f"{number},{row.partition(',')[2]}" for number, row in enumerate(log[1:])]
    (files / "frames.csv").write_text("\n".join([log[0].replace("time", "frame"), *rows]) + "\n")
    numbered = (files / "arm.toml", files / "frames.csv", "--no-effects")
    assert "pass --fps" in run(*numbered).output
    right = run(*numbered, "--fps", 125)
    assert right.exit_code == 0, right.output
    assert right.output == run(files / "arm.toml", files / "log.csv", "--no-effects").output
    mapped = run(files / "arm.toml", files / "log.csv", "--map", files / "map.toml", "--fps", 125)
    assert "a robot's log carries its own times and names, and units in its mapping: leave --fps out" in mapped.output


def test_a_known_recording_is_checked_and_its_units_left_out_if_given(data_folder):
    known = run("dfki_design_a0", "dfki-trajectory-13", "--no-effects")
    assert "torques    what the body and friction leave" in known.output, known.output
    given = run("dfki_design_a0", "dfki-trajectory-13", "--no-effects", "--units", "rad")
    assert "has known units and times: leave --units out" in given.output


def test_effects_stand_once_with_their_places(files):
    outcome = run(files / "arm.toml", files / "log.csv")
    assert outcome.exit_code == 0, outcome.output
    shown = outcome.output[outcome.output.index("would show") :]
    assert max(map(len, shown.splitlines())) <= 100
    flat = " ".join(shown.split())
    assert "viscous_friction (shoulder, elbow)" in flat
    assert flat.count("viscous_friction") == 1


@pytest.mark.filterwarnings("default:.*taken as a body in space:UserWarning")
def test_a_log_of_an_arm_with_a_mass_off_the_line_is_of_a_body_in_space(tmp_path):
    """A counterweight next to the line of the joints explains its share of the torques."""
    pytest.importorskip("mujoco")
    links = [("shoulder", "0 0 0", "0.15 0 0"), ("elbow", "0.3 0 0", "0.1 0 0.08")]
    inner, outer = (
        f'<body pos="{at}"><joint name="{joint}" axis="0 -1 0"/>'
        f'<inertial mass="1" pos="{mass}" diaginertia="0.01 0.01 0.01"/>'
        for joint, at, mass in links
    )
    site = '<site name="tip" pos="0.25 0 0"/>'
    arm = f"<mujoco><worldbody>{inner}{outer}{site}</body></body></worldbody></mujoco>"
    (tmp_path / "arm.xml").write_text(arm)
    tree = Body.load(tmp_path / "arm.xml", dimensions=3)
    time = np.arange(0, 4, 0.01)
    rate = np.array([2.0, 3.0])
    q, qd, qdd = (
        f(np.outer(time, rate)) for f in (np.sin, lambda x: rate * np.cos(x), lambda x: -(rate**2) * np.sin(x))
    )
    torque = dynamics_for(tree).inverse(*map(torch.tensor, (q, qd, qdd)), tree.parameters()).numpy()
    table = np.column_stack([time, q, torque])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", comments="", header="time,q1,q2,u1,u2")
    joints = "".join(
        f'[joints.{joint}]\nangle = {{track = "q{n}", unit = "rad"}}\ntorque = {{track = "u{n}"}}\n'
        for n, (joint, *_) in enumerate(links, 1)
    )
    (tmp_path / "map.toml").write_text(f'time_unit = "s"\n{joints}')
    found = run(tmp_path / "arm.xml", tmp_path / "log.csv", "--map", tmp_path / "map.toml", "--no-effects")
    assert "nothing looks wrong" in found.output
    assert "taken as a body in space" in found.output


CART = """name = "cart"
dimensions = 3
gravity = [0.0, 0.0, -9.81]
[[links]]
name = "cart"
joint = "rail"
type = "slide"
axis = [1.0, 0.0, 0.0]
mass = 1.0
inertia = [0.01, 0.01, 0.01, 0.0, 0.0, 0.0]
com = [0.0, 0.0, 0.0]
[[links]]
name = "pole"
parent = "cart"
joint = "hinge"
axis = [0.0, 1.0, 0.0]
mass = 0.5
com = [0.0, 0.0, -0.2]
inertia = [0.01, 0.01, 0.001, 0.0, 0.0, 0.0]
"""


@pytest.fixture
def cart(tmp_path):
    """A cart on a rail with a pole, its log in mm and degrees, and what writes a mapping of it."""
    (tmp_path / "cart.toml").write_text(CART)
    tree = load_body(tmp_path / "cart.toml")
    time = np.arange(0, 4, 0.01)
    wave, rate = np.outer(time, [2.0, 3.0]), np.array([2.0, 3.0])
    size = np.array([0.3, 0.8])
    q, qd, qdd = size * np.sin(wave), size * rate * np.cos(wave), -size * rate**2 * np.sin(wave)
    force = dynamics_for(tree).inverse(*map(torch.tensor, (q, qd, qdd)), tree.parameters()).numpy()
    table = np.column_stack([time, q * [1e3, 180 / np.pi], force])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", comments="", header="time,x,q,f,u")

    def mapped(shift, turn="deg"):
        unit = f', unit = "{shift}"' if shift else ""
        text = f'[joints.rail]\nangle = {{track = "x"{unit}}}\ntorque = "f"\n'
        (tmp_path / "map.toml").write_text(
            f'time_unit = "s"\n{text}[joints.hinge]\nangle = {{track = "q", unit = "{turn}"}}\ntorque = "u"\n'
        )
        return run(tmp_path / "cart.toml", tmp_path / "log.csv", "--map", tmp_path / "map.toml", "--no-effects")

    return mapped


def test_a_slide_is_logged_in_a_unit_of_length(cart):
    found = cart("mm")
    assert found.exit_code == 0, found.output
    assert "nothing looks wrong" in found.output


@pytest.mark.long
def test_a_slide_in_millimetres_is_found(cart):
    for unit in ("", "m"):
        wrong = cart(unit)
        assert wrong.exit_code == 2
        assert "joint rail shifts by 600 m" in wrong.output
        assert 'write unit = "mm" (or "cm") in the line "angle = …" of [joints.rail]' in wrong.output


def test_units_are_of_the_joints_kind(cart):
    assert "joints.rail.angle: the joint shifts: expected a unit of m, cm, mm" in cart("deg").output
    assert "joints.hinge.angle: the joint turns: expected a unit of rad, deg" in cart("mm", "cm").output


@pytest.mark.parametrize(("share", "said"), [(0.39, False), (0.41, True)])
def test_a_joint_whose_torques_are_not_explained_is_named_first(share, said):
    """Two zeros that are off together, as of a robot's table of another convention, have no single remedy."""
    found = Check("log", (), 0.2, {"base": 0.1, "lift": share}, (), None)
    first = check_text(found).splitlines()[0]
    assert first.startswith("right      nothing looks wrong")
    assert ("and yet 40 % or more of the torques is not explained at lift" in first) == said


def test_a_doubt_is_told_after_what_looks_right():
    lines = check_text(Check("log", (), 0.2, {"base": 0.1}, (), None, doubt="they may be shares")).splitlines()
    assert lines[:2] == ["right      nothing looks wrong", "doubt      they may be shares"]
