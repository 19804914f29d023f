"""A spec or a model with changes is what MuJoCo compiles of the corrected file."""

import mujoco
import numpy as np
import pytest
from in_space import ARM
from robot_xml import robot

from invdyn.diagnosis.write_back import mjcf
from invdyn.diagnosis.write_back.changes import IMPEDANCE, SERVO_DAMPING, ZERO, FileChange
from invdyn.diagnosis.write_back.in_memory import FORGETS, NO_ROOM, OTHERWISE, SET, changed_model, changed_spec
from invdyn.models import Body

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
OF_ROBOT = {
    ("shoulder", "damping"): 0.41,
    ("shoulder", "friction"): 0.07,
    ("elbow", "armature"): 0.03,
    ("elbow", "stiffness"): 1.7,
    ("elbow", "rest"): 0.3,
    ("elbow", IMPEDANCE): 0.97,
    ("elbow", ZERO): 0.2,
    ("shoulder", "servo gain"): 1.5,
    ("shoulder", SERVO_DAMPING): 4.0,
    ("elbow", "motor gain"): 0.8,
    ("elbow", "motor limit"): 5.0,
    ("elbow", "motor delay"): 0.013,
    ("fore", "mass"): 0.9,
    ("", "gravity_x"): 0.4,
}
OF_ARM = {("fore", "com_z"): 0.01, ("fore", "inertia_xx"): 6e-4, ("fore", "inertia_xy"): 1e-4, ("tip", "payload"): 0.2}


def changes(values):
    return [FileChange(place, what, 0.0, value, (value, value), "u", "test") for (place, what), value in values.items()]


@pytest.mark.parametrize(
    ("text", "values"), [(robot(degrees=True, servo=True), OF_ROBOT), (ARM, OF_ARM)], ids=["robot", "arm"]
)
def test_a_spec_and_a_model_are_the_compiled_copy_of_the_file(tmp_path, text, values):
    path = tmp_path / "robot.xml"
    path.write_text(text)
    spec, asked = mujoco.MjSpec.from_string(text), changes(values)
    body = Body.load(path, filmed=False)
    for same in (spec, spec.compile()):
        assert Body.load(same, filmed=False).links == body.links
    own = spec.to_xml()
    new, unsaid = mjcf.rewritten(text.encode(), str(path), body, asked)
    assert not unsaid
    wanted = mujoco.MjModel.from_xml_string(new.decode())
    copy, unsaid = changed_spec(spec, body, asked)
    assert not unsaid
    found = {"spec": copy.compile()}
    if "payload" not in {what for _, what in values}:
        found["model"], unsaid = changed_model(spec.compile(), body, asked)
        assert unsaid == {each.words: FORGETS for each in asked if each.quantity == "motor delay"}
    before = mujoco.MjModel.from_xml_string(text)
    for kind, model in found.items():
        assert model.opt.gravity == pytest.approx(wanted.opt.gravity, abs=1e-6)
        for array in (*SET, "dof_invweight0", "actuator_history"):
            if kind == "model" and array in ("actuator_delay", "actuator_history"):
                continue  # no room for them
            one, other = getattr(model, array), getattr(wanted, array)
            np.testing.assert_allclose(one, other, rtol=2e-5, atol=1e-7, err_msg=f"{kind} {array}")
    touched = [
        a
        for a in SET
        if getattr(before, a).shape != getattr(wanted, a).shape or (getattr(before, a) != getattr(wanted, a)).any()
    ]
    assert len(touched) >= (4 if text is ARM else 12)
    assert spec.to_xml() == own


def test_meshes_in_memory_stay_there():
    corners = b"".join(b"v %d %d %d\n" % (x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1))
    faces = b"".join(
        b"f %d %d %d\n" % f
        for f in [
            (1, 3, 2),
            (2, 3, 4),
            (5, 6, 7),
            (6, 8, 7),
            (1, 2, 5),
            (2, 6, 5),
            (3, 7, 4),
            (4, 7, 8),
            (1, 5, 3),
            (3, 5, 7),
            (2, 4, 6),
            (4, 8, 6),
        ]
    )
    text = robot().replace(
        "<worldbody>", '<asset><mesh name="box" file="box.obj" scale=".1 .1 .1"/></asset><worldbody>'
    )
    text = text.replace('<site name="tip"', '<geom type="mesh" mesh="box" mass="0"/><site name="tip"')
    spec = mujoco.MjSpec.from_string(text, assets={"box.obj": corners + faces})
    body = Body.load(spec, filmed=False)
    (change,) = changes({("elbow", "damping"): 0.4})
    assert changed_spec(spec, body, [change])[0].compile().dof_damping[1] == 0.4


def test_what_a_copy_cannot_say_is_said():
    text = ARM.replace('name="lift" axis="0 1 0" damping="0.1"', 'name="lift" axis="0 1 0" springdamper="0.2 0.5"')
    spec = mujoco.MjSpec.from_string(text)
    body = Body.load(spec, filmed=False)
    damping, payload = changes({("lift", "damping"): 0.3, ("tip", "payload"): 0.1})
    assert changed_spec(spec, body, [damping])[1] == {damping.words: OTHERWISE}
    assert changed_model(spec.compile(), body, [payload])[1] == {payload.words: NO_ROOM}
