"""What a file's simulation is off by, where it is the one that made the log."""

import mujoco
import numpy as np
import pytest
import robot_xml
from robot_xml import play, robot

from invdyn.diagnosis.write_back.rollout import Commands, commands, rollout, smoothed_states
from invdyn.models import Body

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 250.0])
def test_the_true_file_is_off_by_little_at_any_frame_rate(rate, tmp_path, monkeypatch):
    """Angles have noise of .011 degrees; a second after it begins, a velocity of .2 degrees/s too much makes .1."""
    monkeypatch.setattr(robot_xml, "RATE", rate)
    file = tmp_path / "robot.xml"
    file.write_text(robot())
    body, log = Body.load(file), play(robot())
    given = commands(mujoco.MjModel.from_xml_path(str(file)), body, log)
    off = rollout(str(file), body, log.time, log.angles, given)
    assert off.windows == 4
    assert np.degrees(off.total) < 0.2


@pytest.mark.parametrize(("rate", "noise", "most"), [(50.0, 1e-6, 1e-3), (50.0, 1e-3, 0.04), (1000.0, 1e-3, 0.04)])
def test_velocities_are_near_the_true_ones_whatever_noise_and_rate(rate, noise, most):
    time = np.arange(0, 6, 1 / rate)
    angle = np.stack([1.2 * np.sin(7 * time), 0.5 * np.sin(11 * time)], -1)
    truth = np.stack([8.4 * np.cos(7 * time), 5.5 * np.cos(11 * time)], -1)
    noisy = angle + noise * np.random.default_rng(0).standard_normal(angle.shape)
    velocity = smoothed_states(time, noisy).mean[:, 2:]
    assert np.sqrt(np.mean((velocity - truth)[5:-5] ** 2)) < most


POLE = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="pole" axis="0 1 0"/>
<inertial pos="0 0 0.5" mass="{mass}" diaginertia="0.02 0.02 0.001"/><site name="tip" pos="0 0 1"/></body></worldbody>
<actuator><motor joint="pole"/></actuator></mujoco>"""


def test_of_an_unstable_arm_the_true_file_is_nearer_though_states_are_noisy(tmp_path):
    """A pole that is balanced upright: an error of its start grows as e^{3.8 t}, whichever file plays it."""
    true = mujoco.MjModel.from_xml_string(POLE.format(mass=1.2))
    data, rng = mujoco.MjData(true), np.random.default_rng(3)
    rows, angles, torques = 600, np.zeros((600, 1)), np.zeros((600, 1))
    for row in range(rows):
        seen = data.qpos[0] + 2e-3 * rng.standard_normal()
        wanted = 0.4 * np.sin(2.2 * row / 50)
        angles[row], torques[row] = seen, -30 * (seen - wanted) - 6 * data.qvel[0]
        data.ctrl[:] = torques[row]
        mujoco.mj_step(true, data, 10)
    off = {}
    for name, mass in (("as it was", 1.0), ("corrected", 1.2)):
        file = tmp_path / f"{mass}.xml"
        file.write_text(POLE.format(mass=mass))
        body = Body.load(file)
        zero = body.joint_parts[0].zero if body.joint_parts[0] else 0.0
        sign = body.joint_parts[0].sign if body.joint_parts[0] else 1.0
        given = Commands(torques, np.zeros((rows, 1)))
        off[name] = rollout(str(file), body, np.arange(rows) / 50, zero + sign * angles, given)
    assert off["corrected"].total < 0.004  # the encoder's noise is .002
    assert off["as it was"].total > 3 * off["corrected"].total
    assert off["corrected"].windows == 12


def test_a_replay_that_runs_away_is_infinite_and_no_error(tmp_path):
    file = tmp_path / "pole.xml"
    file.write_text(POLE.format(mass=1.0))
    body, time = Body.load(file), np.arange(200) / 50
    given = Commands(np.full((200, 1), 1e7), np.zeros((200, 1)))
    found = rollout(str(file), body, time, 0.01 * np.sin(time)[:, None], given)
    assert not np.isfinite(found.whole)
