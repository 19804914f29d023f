"""A log of the file's own first-order engine is no gap, and its true faults are found beside what its steps do."""

import mujoco
import numpy as np
import pytest

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.report.sentences import details
from invdyn.models import Body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")

TEXT = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="{integrator}"/><worldbody>
<body name="fore" pos="0 0 1"><joint name="elbow" axis="0 1 0" damping="{damping}" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.015" mass="0.5" contype="0" conaffinity="0"/>
<site name="tip" pos="0 0 -0.25"/></body></worldbody>
<actuator><position joint="elbow" kp="25" kv="0.5"/></actuator></mujoco>"""
RATE, ROWS = 100, 300
LEFT_OUT = [name for name in EFFECTS if name not in ("viscous_friction", "coulomb_friction", "armature")]


def diagnosed(folder, integrator: str, damping: float):
    """What is said of a log that MuJoCo made by an integrator; the file has "implicitfast" and damping of .1."""
    path = folder / "robot.xml"
    path.write_text(TEXT.format(integrator="implicitfast", damping=0.1))
    body = Body.load(path)
    model = mujoco.MjModel.from_xml_string(TEXT.format(integrator=integrator, damping=damping))
    data, time = mujoco.MjData(model), np.arange(ROWS) / RATE
    target = 0.4 * np.sin(4 * time) + 0.3 * np.sin(9 * time)
    angles = np.zeros((ROWS, 1))
    for row in range(ROWS):
        angles[row], data.ctrl[:] = data.qpos, target[row]
        for _ in range(round(1 / RATE / model.opt.timestep)):
            mujoco.mj_step(model, data)
    own = body.joint_parts[0]
    torques = servo_torque(own.servo, own.zero + own.sign * target)[:, None]
    angles = own.zero + own.sign * angles + np.random.default_rng(0).normal(0, 2e-4, angles.shape)
    log = Recording(time, np.empty((ROWS, 0, 2)), (), angles=angles, torques=torques, joint_names=("elbow",))
    return diagnose(log, body, without=LEFT_OUT, most=2)


@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_a_right_file_has_no_gap_whatever_plays_it(tmp_path, integrator):
    found = diagnosed(tmp_path, integrator, 0.1)
    assert not found.gap.detected
    # of a law that no step of the engine is in, nothing is said
    assert any("first-order steps of 1 ms" in line for line in details(found)) == (integrator == "implicitfast")


@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_a_damper_has_its_own_size_beside_the_steps(tmp_path, integrator):
    """Half a step of the servo's stiffness, .0125 N·m·s/rad, is as much as half of it."""
    found = diagnosed(tmp_path, integrator, 0.125)
    best = max(found.causes, key=lambda cause: cause.probability)
    (finding,) = best.effects
    assert finding.effect == "viscous_friction"
    assert finding.parameters["damping"].mean == pytest.approx(0.025, abs=0.003)
