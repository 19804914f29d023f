"""Diagnoses of bodies in space that MuJoCo plays; and of planar ones, told as trees, as they are in the plane."""

from functools import cache

import numpy as np
import pytest
import torch
from in_space import ARM, play
from robot_log import ARM as PLANAR
from robot_log import robot_log
from scipy.spatial.transform import Rotation
from trees import panda

from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.report.arm import arm
from invdyn.diagnosis.report.save import save
from invdyn.diagnosis.report.sentences import verdict
from invdyn.diagnosis.sensitivity.screen import added, screen
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import load_body, write_mjcf
from invdyn.models.effects import EFFECTS

FEW = ("viscous_friction", "coulomb_friction", "armature", "payload", "actuator_delay", "actuator_gain")
REST = [name for name in EFFECTS if name not in FEW]


@pytest.fixture
def body(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    return load_body(tmp_path / "arm.xml")


def screened(recording, body, kinds):
    """The problem, its path, and every effect's screen, best first."""
    bound = diagnosis_problem(recording, body)
    path, _ = data_path(bound)
    bound = bound.shaped(path)
    effects = [effect for effect in considered(bound) if effect.name in kinds]
    common = unknowns(bound, ())
    return bound, path, screen(bound, bound.model, path, effects, common, common.mean)


@pytest.mark.long
def test_a_planar_arm_told_as_a_tree_is_screened_and_refined_as_the_planar_one():
    log = robot_log(1.2, damping=(0.0, 0.08), camera=False)
    flat, deep = (screened(log, each, FEW) for each in (PLANAR, PLANAR.in_space()))
    evidence = [{key(s.effect): s.log_evidence for s in added(found)} for _, _, found in (flat, deep)]
    assert evidence[0].keys() == evidence[1].keys() >= {"payload", "armature.elbow", "actuator_delay"}
    for name, value in evidence[0].items():
        assert evidence[1][name] == pytest.approx(value, abs=0.05), name  # nats; slopes are differences
    causes = []
    for bound, path, _ in (flat, deep):
        friction = EFFECTS["viscous_friction"]("elbow").bound(bound.model.body)
        causes.append(refine(bound, (friction,), {f"{friction.key}.damping": 0.05}, path, 0.01))
    assert causes[0].mean == pytest.approx(causes[1].mean, rel=1e-3)
    assert causes[0].mean[0] == pytest.approx(0.08, rel=0.1)


@pytest.mark.quick("-payload")
@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"damping": {"lift": 0.3}}, "viscous_friction.lift"),
        ({"friction": {"lift": 0.3}}, "coulomb_friction.lift"),
        ({"armature": {"bend": 0.005}}, "armature.bend"),
        ({"late": 0.03}, "actuator_delay"),
        ({"payload": 0.2, "encoders": None, "cameras": 0.001}, "payload"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_three_hinges_in_space(body, change, name):
    _, _, found = screened(play(ARM, 1.5, **change), body, FEW)
    assert key(added(found)[0].effect) == name
    assert added(found)[0].log_evidence > next(s.log_evidence for s in found if s.effect is None) + 30


@cache
def loaded_arm():
    return play(ARM, 1.5, payload=0.2, cameras=0.001)


@pytest.mark.long
def test_a_payload_is_found_said_drawn_and_written_into_the_file(body, tmp_path):
    log = loaded_arm()
    found = diagnose(log, body, without=REST, most=1)
    (effect,) = found.causes[0].effects
    assert effect.key == "payload"
    assert effect.parameters["mass"].mean == pytest.approx(0.2, rel=0.01)
    assert "a payload" in verdict(found)
    assert "base_motion" in found.to_json()["search"]["planar_only"]
    assert arm(found).count("<svg") == 2
    found = write_back(found, tmp_path / "arm.xml", body, tmp_path / "corrected.xml", log, held_out=False)
    errors = found.written.rollout["total_rms_rad"]
    assert errors["after"] < 0.2 * errors["before"]
    again = load_body(tmp_path / "corrected.xml")
    assert float(again.parameters().mass[2]) == pytest.approx(0.7 + effect.parameters["mass"].mean, abs=1e-6)
    save(found, tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "from the side" in page


def test_uncertain_numbers_of_a_tree_are_left_free(tmp_path):
    path = tmp_path / "tree.toml"
    tree = PLANAR.in_space()
    tree.to_toml(path)
    text = path.read_text().replace("mass = 1.5", "mass = {mean = 1.5, sd = 0.1}")
    path.write_text(text)
    bound = diagnosis_problem(robot_log(0.5, camera=False), load_body(path))
    (mass,) = bound.uncertain
    assert (mass.name, mass.mean, mass.sd) == ("body.mass.0", pytest.approx(1.5), pytest.approx(0.1))
    sets = unknowns(bound, ()).set_in(bound.model, np.array([[1.4], [1.6]]))
    assert sets.body_parameters().mass[:, 0].tolist() == [[1.4, 1.0], [1.6, 1.0]]


def test_a_base_that_leans_turns_gravity_about_the_level_axes(body):
    """By a rotation vector, as scipy has it."""
    tilt = EFFECTS["gravity_tilt"]().bound(body)
    assert [p.name for p in tilt.parameters(diagnosis_problem(play(ARM, 0.3), body).model.scale)] == [
        "about_x",
        "about_y",
    ]
    p = {"about_x": torch.tensor([0.1]).double(), "about_y": torch.tensor([-0.2]).double()}
    turned = tilt.body(p, body.parameters()).gravity
    assert turned.numpy() == pytest.approx(Rotation.from_rotvec([0.1, -0.2, 0.0]).apply([0.0, 0.0, -9.81]))
    none = {name: torch.zeros(1).double() for name in p}
    assert tilt.body(none, body.parameters()).gravity.tolist() == [0.0, 0.0, -9.81]


@pytest.mark.long
def test_seven_hinges_in_space(tmp_path):
    write_mjcf(panda(), tmp_path / "panda.xml")
    text = (tmp_path / "panda.xml").read_text(encoding="utf-8")
    log = play(text, 0.6, middle=(0.0, -0.3, 0.0, -1.9, 0.0, 1.6, 0.8), friction={"joint4": 1.0})
    _, _, found = screened(log, load_body(tmp_path / "panda.xml"), ("coulomb_friction", "viscous_friction", "payload"))
    assert key(added(found)[0].effect) == "coulomb_friction.joint4"


def test_numbers_of_links_in_space_are_those_of_the_plane():
    """A payload and an inertial error do to a planar arm's tree what they do to the planar arm."""
    tree = PLANAR.in_space()
    for effect, p, q in (
        (EFFECTS["payload"](), {"mass": 0.3}, {"mass": 0.3}),
        (
            EFFECTS["inertial_error"]("fore"),
            {"mass": 0.2, "com": 0.03, "inertia": 0.001},
            # its three moments are (0, I, I): about z twice what the mean is
            {"mass": 0.2, "com_x": 0.03, "com_y": 0.0, "com_z": 0.0, "inertia": 0.001 * 2 / 3},
        ),
    ):
        flat, deep = (
            effect.bound(body).body(
                {n: torch.tensor([v], dtype=torch.float64) for n, v in own.items()}, body.parameters()
            )
            for body, own in ((PLANAR, p), (tree, q))
        )
        assert torch.allclose(flat.mass, deep.mass)
        assert torch.allclose(flat.com, deep.com[:, 0])
        assert torch.allclose(flat.inertia, deep.inertia[:, 2])
    assert not tree.is_chain
    assert tree.hand == PLANAR.hand == (1, 1)
