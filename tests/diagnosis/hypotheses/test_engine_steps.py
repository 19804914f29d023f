"""A log of the file's own first-order engine is no gap, and its true faults are found beside what its steps do."""

import numpy as np
import pytest
from servo_in_mujoco import servo_log, servo_mjcf

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.report.sentences import details
from invdyn.models import Body
from invdyn.models.effects import EFFECTS

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")

SERVO = {"kp": 25, "kv": 0.5}
LEFT_OUT = [name for name in EFFECTS if name not in ("viscous_friction", "coulomb_friction", "armature")]


def target(time):
    return 0.4 * np.sin(4 * time) + 0.3 * np.sin(9 * time)


def diagnosed(folder, integrator: str, damping: float):
    """What is said of a log that MuJoCo made by an integrator; the file has "implicitfast" and damping of .1."""
    path = folder / "robot.xml"
    path.write_text(servo_mjcf("implicitfast", 0.1, **SERVO))
    body = Body.load(path)
    log = servo_log(servo_mjcf(integrator, damping, **SERVO), body, target, rate=100, rows=300)
    return diagnose(log, body, without=LEFT_OUT, most=2)


@pytest.mark.quick("RK4")
@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_a_right_file_has_no_gap_whatever_plays_it(tmp_path, integrator):
    found = diagnosed(tmp_path, integrator, 0.1)
    assert not found.gap.detected
    # of a law that no step of the engine is in, nothing is said
    assert any("first-order steps of 1 ms" in line for line in details(found)) == (integrator == "implicitfast")


@pytest.mark.long
@pytest.mark.parametrize("integrator", ["implicitfast", "RK4"])
def test_a_damper_has_its_own_size_beside_the_steps(tmp_path, integrator):
    """Half a step of the servo's stiffness, .0125 N·m·s/rad, is as much as half of it."""
    found = diagnosed(tmp_path, integrator, 0.125)
    best = max(found.causes, key=lambda cause: cause.probability)
    (finding,) = best.effects
    assert finding.effect == "viscous_friction"
    assert finding.parameters["damping"].mean == pytest.approx(0.025, abs=0.003)
