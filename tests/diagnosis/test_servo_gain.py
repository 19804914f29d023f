"""A servo whose gain is not its file's is named, with its size, and its file corrected."""

import mujoco
import numpy as np
import pytest
from servo_in_mujoco import servo_log, servo_mjcf

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import Body
from invdyn.models.effects import EFFECTS

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")

KEPT = ("actuator_gain", "viscous_friction")


def target(time):
    return 0.6 * np.sin(3 * time) + 0.3 * np.sin(8 * time)


@pytest.mark.long
def test_a_gain_of_eight_tenths(tmp_path):
    path, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    path.write_text(servo_mjcf("RK4", 0.05, kp=10, kv=0.3))
    body = Body.load(path)
    log = servo_log(servo_mjcf("RK4", 0.05, kp=8, kv=0.3), body, target, rate=50, rows=120)
    found = diagnose(log, body, without=[name for name in EFFECTS if name not in KEPT], most=1)
    best = max(found.causes, key=lambda cause: cause.probability)
    assert [finding.key for finding in best.effects] == ["actuator_gain.elbow"]
    assert best.effects[0].parameters["gain"].mean == pytest.approx(-0.2, abs=0.01)
    told = write_back(found, path, body, copy, log, False).written
    assert [change["quantity"] for change in told.changes] == ["servo gain"]
    assert mujoco.MjModel.from_xml_path(str(copy)).actuator_gainprm[0, 0] == pytest.approx(8.0, rel=0.02)
    assert told.rollout["total_rms_rad"]["after"] < 0.1 * told.rollout["total_rms_rad"]["before"]
