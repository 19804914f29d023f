"""A servo whose gain is not its file's is named, with its size, and its file corrected."""

import mujoco
import numpy as np
import pytest

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import Body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")

TEXT = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="RK4"/><worldbody>
<body name="fore" pos="0 0 1"><joint name="elbow" axis="0 1 0" damping="0.05" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.015" mass="0.5" contype="0" conaffinity="0"/>
<site name="tip" pos="0 0 -0.25"/></body></worldbody>
<actuator><position joint="elbow" kp="{kp}" kv="0.3"/></actuator></mujoco>"""
RATE, ROWS = 50, 200
KEPT = ("actuator_gain", "joint_stiffness", "payload", "viscous_friction")


def test_a_gain_of_eight_tenths(tmp_path):
    path, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    path.write_text(TEXT.format(kp=10))
    body = Body.load(path)
    model = mujoco.MjModel.from_xml_string(TEXT.format(kp=8))
    data, time = mujoco.MjData(model), np.arange(ROWS) / RATE
    target = 0.6 * np.sin(3 * time) + 0.3 * np.sin(8 * time)
    angles = np.zeros((ROWS, 1))
    for row in range(ROWS):
        angles[row], data.ctrl[:] = data.qpos, target[row]
        for _ in range(round(1 / RATE / model.opt.timestep)):
            mujoco.mj_step(model, data)
    own = body.joint_parts[0]
    torques = servo_torque(own.servo, own.zero + own.sign * target)[:, None]
    angles = own.zero + own.sign * angles + np.random.default_rng(0).normal(0, 2e-4, angles.shape)
    log = Recording(time, np.empty((ROWS, 0, 2)), (), angles=angles, torques=torques, joint_names=("elbow",))
    found = diagnose(log, body, without=[name for name in EFFECTS if name not in KEPT], most=2)
    best = max(found.causes, key=lambda cause: cause.probability)
    assert [finding.key for finding in best.effects] == ["actuator_gain.elbow"]
    assert best.effects[0].parameters["gain"].mean == pytest.approx(-0.2, abs=0.01)
    told = write_back(found, path, body, copy, log, False).written
    assert [change["quantity"] for change in told.changes] == ["servo gain"]
    assert mujoco.MjModel.from_xml_path(str(copy)).actuator_gainprm[0, 0] == pytest.approx(8.0, rel=0.02)
    assert told.rollout["total_rms_rad"]["after"] < 0.1 * told.rollout["total_rms_rad"]["before"]
