"""What a file's simulation is off by, where it is the one that made the log."""

import mujoco
import numpy as np
import pytest
import robot_xml
from robot_xml import play, robot

from invdyn.diagnosis.write_back.rollout import commands, rollout, states
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
    _, velocity = states(time, noisy)
    assert np.sqrt(np.mean((velocity - truth)[5:-5] ** 2)) < most
