"""`invdyn.diagnose` and `invdyn.corrected` take a simulation from memory as from its file."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from robot_xml import play, robot

import invdyn
from invdyn.diagnosis.write_back import changes, output_error, write_back
from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.models import Body
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError
from invdyn.robot_diagnosis import arguments_of

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
JOINTS = (("shoulder", 1, 1), ("elbow", 2, 10))


@pytest.fixture
def files(tmp_path):
    """A robot's file, and the log, its map, of one whose elbow has .25 more damping."""
    (tmp_path / "robot.xml").write_text(robot())
    log = play(robot().replace('damping="0.1"', 'damping="0.35"'), seconds=2.0)
    body = Body.load(tmp_path / "robot.xml", filmed=False)
    zero, sign = (np.array([getattr(own, key) for own in body.joint_parts]) for key in ("zero", "sign"))
    rows = np.column_stack([log.time, sign * (log.angles - zero), sign * log.torques / [1, 10]])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="time,q1,q2,u1,u2", comments="", fmt="%.9f")
    lines = [
        f'[joints.{name}]\nangle = "q{k}"\ntorque = {{track = "u{k}", gear = {gear}}}\n' for name, k, gear in JOINTS
    ]
    (tmp_path / "map.toml").write_text("".join(lines))
    return tmp_path


def test_a_log_reads_the_same_for_a_spec_a_model_and_a_file(files):
    spec = mujoco.MjSpec.from_file(str(files / "robot.xml"))
    of_file, *others = (
        arguments_of(files / "log.csv", each, files / "map.toml", {"workers": 1})
        for each in (files / "robot.xml", spec, spec.compile())
    )
    for other in others:
        assert other["body"].links == of_file["body"].links
        np.testing.assert_array_equal(other["recording"].torques, of_file["recording"].torques)
        assert other["robot"] is of_file["robot"] is True


def test_another_object_is_no_robot(files):
    with pytest.raises(BodyError, match=r"expected a robot as a file, a mujoco\.MjSpec .*, got dict"):
        invdyn.diagnose(files / "log.csv", {}, mapping=files / "map.toml")


def test_what_is_no_log_is_refused_in_one_line(files):
    recording = arguments_of(files / "log.csv", files / "robot.xml", files / "map.toml", {"workers": 1})["recording"]
    for log, mapping in (([], None), ([recording, files / "log.csv"], None), (recording, files / "map.toml")):
        with pytest.raises(InputError, match=r"a log's file.*, got (none|both|a recording)"):
            arguments_of(log, files / "robot.xml", mapping, {})


def test_numbers_fitted_together_are_set_together_or_not_at_all(files, monkeypatch):
    """A compiled model has no room for a payload: then the damping that was fitted beside it is not set, either."""

    def change(place, what, value):
        return FileChange(place, what, 0.1, value, (value, value), "u", "test")

    alone, beside, payload = (
        change("elbow", "damping", 0.3),
        change("elbow", "damping", 0.4),
        change("fore", "payload", 1.0),
    )
    monkeypatch.setattr(write_back, "best", lambda diagnosis: "a cause")
    monkeypatch.setattr(changes, "correction", lambda cause, body: changes.Correction((alone,), {}))
    monkeypatch.setattr(output_error, "refine", lambda *_: SimpleNamespace(changes=(beside, payload)))
    model = mujoco.MjModel.from_xml_string(robot())
    new = invdyn.corrected(None, model, files / "log.csv", mapping=files / "map.toml")
    assert new.joint("elbow").damping.item() == 0.3


@pytest.mark.long
def test_a_spec_is_diagnosed_and_corrected(files):
    """Damping by a diagnosis of the spec, at .35 in the copy, and the original as it was."""
    spec = mujoco.MjSpec.from_string(robot())
    left_out = ",".join(e for e in EFFECTS if e not in ("viscous_friction", "armature", "payload"))
    found = invdyn.diagnose(files / "log.csv", spec, mapping=files / "map.toml", exclude=left_out, max_effects=1)
    for own in (spec, spec.compile(), files / "robot.xml"):
        new = invdyn.corrected(found, own)
        assert isinstance(new, mujoco.MjModel if isinstance(own, mujoco.MjModel) else mujoco.MjSpec)
        model = new if isinstance(new, mujoco.MjModel) else new.compile()
        assert model.joint("elbow").damping.item() == pytest.approx(0.35, rel=0.05)
        assert model.joint("shoulder").damping.item() == 0.3
    assert spec.compile().joint("elbow").damping.item() == 0.1
