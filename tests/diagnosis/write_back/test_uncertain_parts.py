"""What a robot's file says of its joints and calls uncertain is learned, with a cause or alone; what is fixed stays."""

from dataclasses import replace

import pytest
import torch
from in_space import ARM, play
from robot_xml import robot

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.problem.uncertain import uncertain_numbers
from invdyn.diagnosis.report.sentences import details
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import Body, load_body
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
KEPT = ("viscous_friction", "armature")
STRUCK = [name for name in EFFECTS if name not in KEPT]


@pytest.fixture
def nominal(tmp_path):
    (tmp_path / "robot.xml").write_text(robot())
    return Body.load(tmp_path / "robot.xml")


def played(body, seed):
    """A log of the robot with another damping at the elbow and another rotor at the shoulder, by the model itself."""
    arm = random_arm(body, duration=2, fps=50, noise=0.002, encoder_noise=5e-4, commanded=True, seed=seed)
    rotors, damping = (torch.tensor(values, dtype=torch.float64) for values in ((0.07, 0.0), (0.3, 0.14)))
    return record(arm.replace(**{"body.armature": rotors, "body.damping": damping}), seed)[0]


@pytest.mark.long
def test_a_free_number_is_learned_beside_the_cause_and_a_fixed_one_stays(nominal, tmp_path):
    body = replace(nominal, uncertainty={"damping.elbow": 0.5})
    log, held_out = (played(nominal, seed) for seed in (3, 4))
    found = diagnose(log, body, without=STRUCK, most=1)
    cause = max(found.causes, key=lambda c: c.probability + c.in_part)
    assert [f.key for f in cause.effects] == ["armature.shoulder"]
    (number,) = cause.learned  # the shoulder's damping is not among them
    low, high = number.change.after.interval_90
    assert (number.place, number.quantity, number.change.before) == ("elbow", "damping", 0.1)
    assert low < 0.14 < high, (low, high)
    assert high - low < 0.2 * 0.14  # the prior's is ± 0.08
    assert any(s.startswith("Learned: damping of the elbow") or "damping of elbow" in s for s in details(found))
    written = write_back(found, tmp_path / "robot.xml", body, tmp_path / "corrected.xml", held_out, True).written
    assert {(c["place"], c["quantity"]) for c in written.changes} == {("shoulder", "armature"), ("elbow", "damping")}
    copy = {link.joint.name: link.parts for link in Body.load(tmp_path / "corrected.xml").links}
    assert copy["shoulder"].damping == 0.3
    assert copy["elbow"].damping == pytest.approx(number.change.after.mean, rel=1e-4)
    assert written.rollout["total_rms_rad"]["after"] < 0.15 * written.rollout["total_rms_rad"]["before"]


def test_what_is_uncertain_is_said_by_quantity_or_of_one_joint(nominal, tmp_path):
    def free(**stated):
        names = {key.replace("_of_", "."): sd for key, sd in stated.items()}
        return {(u.name, round(u.sd, 12)) for u in uncertain_numbers(replace(nominal, uncertainty=names))}

    assert free(damping=0.5) == {("body.damping.0", 0.15), ("body.damping.1", 0.05)}
    assert free(damping=0.5, damping_of_elbow=0.0) == {("body.damping.0", 0.15)}
    assert free(friction=0.5) == set()  # no joint of the file has any: an effect is looked for
    with pytest.raises(BodyError, match=r"uncertainty of damping\.wrist: expected a joint among shoulder, elbow"):
        replace(nominal, uncertainty={"damping.wrist": 0.1})
    stated = replace(nominal, uncertainty={"mass": 0.05, "armature.shoulder": 0.5})
    stated.to_toml(tmp_path / "robot.toml")
    assert Body.load(tmp_path / "robot.toml") == stated
    told = (tmp_path / "robot.toml").read_text().replace('"armature.shoulder"', "armature.shoulder")
    (tmp_path / "robot.toml").write_text(told)
    assert Body.load(tmp_path / "robot.toml") == stated


@pytest.mark.long
def test_masses_of_a_tree_are_learned_beside_the_cause_and_written(tmp_path):
    """MuJoCo plays a forearm a tenth heavier than its file says, and a shoulder with more damping."""
    (tmp_path / "arm.xml").write_text(ARM)
    tree = replace(load_body(tmp_path / "arm.xml"), uncertainty={"mass": 0.1})
    assert [u.name for u in uncertain_numbers(tree)] == ["body.mass.0", "body.mass.1", "body.mass.2"]
    log, held_out = (play(ARM.replace('mass="0.7"', 'mass="0.77"'), 2.0, n, damping={"lift": 0.3}) for n in (0, 1))
    found = diagnose(log, tree, without=STRUCK, most=1)
    cause = max(found.causes, key=lambda c: c.probability + c.in_part)
    assert [f.key for f in cause.effects] == ["viscous_friction.lift"]
    written = write_back(found, tmp_path / "arm.xml", tree, tmp_path / "corrected.xml", held_out, True).written
    assert {(c["place"], c["quantity"]) for c in written.changes} >= {("lift", "damping"), ("fore", "mass")}
    fore = next(c for c in written.changes if (c["place"], c["quantity"]) == ("fore", "mass"))
    assert fore["interval_90"][0] < 0.77 < fore["interval_90"][1]
    assert load_body(tmp_path / "corrected.xml").parameters().mass[2].item() == pytest.approx(0.77, abs=0.02)
    assert written.rollout["total_rms_rad"]["after"] < 0.1 * written.rollout["total_rms_rad"]["before"]
