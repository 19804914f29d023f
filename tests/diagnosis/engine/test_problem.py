"""What a log must have before MuJoCo's engine diagnoses it: commands of servos, and angles that the joints can have."""

from dataclasses import replace

import linkages
import mujoco
import numpy as np
import pytest

from invdyn.diagnosis.check.before import check_numbers
from invdyn.diagnosis.engine.problem import commands, sensed
from invdyn.models import Scene
from invdyn.recordings import InputError, Recording

ARM = """<mujoco><compiler angle="radian"/><worldbody><body>
  <joint name="elbow" axis="0 1 0" range="-2 2" limited="true"/><geom size=".1"/></body></worldbody>
  <actuator><position name="servo" joint="elbow" kp="20"/></actuator></mujoco>"""


def log(angles, names, torques=None):
    shown = np.full((len(angles), len(names)), np.nan)
    shown[:, 0] = angles
    return Recording(np.arange(len(angles)) * 0.01, np.empty((len(angles), 0, 3)), (), None, shown, torques, names)


def test_a_torque_at_a_servo_that_has_no_target_is_refused():
    """The servo would pull to 0 beside it."""
    scene, angles = Scene.of(ARM), np.zeros(30)
    with pytest.raises(InputError, match="expected servo_torque, the target of the servo at 'elbow'"):
        commands(log(angles, ("elbow",), np.ones((30, 1))), scene, False)
    both = log(angles, ("elbow", "servo"), np.ones((30, 2)))
    given = commands(both, scene, False)
    assert (given.controls == 1).all()
    assert (given.forces == 1).all()


def test_a_motor_without_a_command_is_at_rest():
    scene = Scene.of(linkages.HOLDING)
    recording = linkages.log_of(scene.model, linkages.grasp, rows=30)
    torques = np.array(recording.torques)
    torques[:, recording.joint_names.index("pulled")] = np.nan
    given = commands(replace(recording, torques=torques), scene, False)
    assert (given.controls[:, scene.actuator_names.index("pulled")] == 0).all()
    assert mujoco.MjModel.from_xml_string(linkages.HOLDING).nu == given.controls.shape[1]


def test_degrees_of_a_joint_that_has_stops_are_refused():
    scene = Scene.of(ARM)
    with pytest.raises(InputError, match=r"expected angles of 'elbow' from -2 to 2 rad, its range, got 0 to 57\.3"):
        sensed(log(np.degrees(np.linspace(0, 1, 30)), ("elbow",)), scene)
    assert sensed(log(np.linspace(-2.1, 2.1, 30), ("elbow",)), scene).joint_names == ("elbow",)


def test_rows_and_sizes_are_looked_at_as_those_of_arms_are():
    shown = np.sin(np.arange(400) * 0.02) + 0.5
    check_numbers(log(shown, ("elbow",)), 0.5, ())
    shown[::9] = 0.0  # another publisher's rows
    strange = log(shown, ("elbow",))
    with pytest.raises(InputError, match="rows have the angles 0, far from the rows around them"):
        check_numbers(strange, 0.5, ())
    with pytest.warns(UserWarning, match="continued, by --force"):
        assert check_numbers(strange, 0.5, (), force=True)
    slow = replace(log(np.linspace(0, 1, 400), ("elbow",)), time=np.arange(400.0))
    with pytest.warns(UserWarning, match="frame numbers"):
        check_numbers(slow, 0.5, ())
    with pytest.warns(UserWarning, match="shifts by 400 m"):
        check_numbers(log(np.linspace(0, 400, 400), ("elbow",)), 0.5, ("elbow",))
