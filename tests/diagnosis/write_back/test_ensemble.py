"""Copies of a file that are draws of the joint posterior, and the ranges that they make."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from reported import diagnosis
from robot_xml import robot

from invdyn.diagnosis.assessment.result import Cause, Change, Estimate, Finding, plain
from invdyn.diagnosis.write_back.ensemble import check_ensemble, drawn, write_ensemble
from invdyn.models import Body
from invdyn.recordings import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
DRAWS = np.random.default_rng(0).multivariate_normal(
    [0.2, 0.05], [[0.02**2, -0.0009 * 0.2], [-0.0009 * 0.2, 1e-4]], 4000
)
MEMBERS = 120


def estimate(draws: np.ndarray, narrowed: float) -> Estimate:
    low, high = np.quantile(draws, [0.05, 0.95])
    return Estimate(float(draws.mean()), float(draws.std()), (float(low), float(high)), "u", draws, narrowed)


def found(probability: float = 0.75):
    """Damping of the elbow and armature of the shoulder, correlated; the second is as wide as its prior."""
    damping, rotor = estimate(DRAWS[:, 0], 0.1), estimate(DRAWS[:, 1], 0.97)
    more = {"inertia": Change(0.02, estimate(0.02 + DRAWS[:, 1], 0.97))}
    effects = (
        Finding("viscous_friction", "dynamics", {"joint": "elbow"}, {"damping": damping},
                {"damping": Change(0.1, estimate(0.1 + DRAWS[:, 0], 0.1))}),
        Finding("armature", "dynamics", {"joint": "shoulder"}, {"inertia": rotor}, more),
    )  # fmt: skip
    return diagnosis(causes=(Cause(effects, probability, 1.0, 0.1), Cause((), 1 - probability, 0.0, 0.1)))


@pytest.fixture
def written(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(robot())
    ranges = write_ensemble(found(), file, Body.load(file), tmp_path, MEMBERS)
    models = [mujoco.MjModel.from_xml_path(str(each)) for each in sorted(tmp_path.glob("robot_*.xml"))]
    return tmp_path, ranges, models


def test_members_are_draws_of_the_joint_posterior_and_of_the_causes(written):
    """Of a cause with probability .75 three quarters; its numbers with the posterior's means, sds and correlation."""
    _, _, models = written
    assert len(models) == MEMBERS
    damping, armature = np.array([[m.dof_damping[1], m.dof_armature[0]] for m in models]).T
    plainly = np.isclose(damping, 0.1) & np.isclose(armature, 0.02)
    share = plainly.mean()
    assert share == pytest.approx(0.25, abs=4 * np.sqrt(0.25 * 0.75 / MEMBERS))
    some = ~plainly
    count = some.sum()
    assert damping[some].mean() == pytest.approx(0.3, abs=4 * 0.02 / np.sqrt(count))
    assert armature[some].std() == pytest.approx(0.01, rel=4 / np.sqrt(2 * count))
    correlation = np.corrcoef(damping[some], armature[some])[0, 1]
    assert correlation == pytest.approx(np.corrcoef(DRAWS.T)[0, 1], abs=0.1)


def test_ranges_are_those_of_the_members_and_say_what_the_log_does_not(written):
    folder, ranges, models = written
    assert json.loads((folder / "randomisation.json").read_text()) == ranges
    damping = next(n for n in ranges["numbers"] if n["quantity"] == "damping")
    values = [m.dof_damping[1] for m in models]
    assert damping["range_90"] == pytest.approx(np.quantile(values, [0.05, 0.95]), rel=1e-5)
    assert (damping["file"], damping["operation"]) == (0.1, "abs")
    assert ranges["not_told_by_the_log"] == ["armature.shoulder.inertia"]
    fields = {each["field"]: each["name"] for each in ranges["mjx"]}
    assert fields == {"dof_damping": "elbow", "dof_armature": "shoulder"}
    (term,) = ranges["isaac_lab"]
    assert term["params"]["asset_cfg"]["joint_names"] == ["shoulder"]
    assert term["params"]["armature_distribution_params"] == ranges["mjx"][-1]["range"]


def test_the_same_seed_gives_the_same_members_and_json_has_no_draws():
    one, other = (drawn(found(), 20, 5) for _ in range(2))
    assert one == other
    assert plain(found().causes[0].effects[0])["parameters"]["damping"].keys() >= {"mean", "sd", "interval_90", "unit"}
    assert "draws" not in plain(found().causes[0].effects[0])["parameters"]["damping"]


def test_without_a_gap_all_members_are_the_file_as_it_was(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(robot())
    none = found()
    none = replace(none, gap=replace(none.gap, detected=False))
    ranges = write_ensemble(none, file, Body.load(file), tmp_path, 3)
    assert ranges["numbers"] == []
    assert all(each.read_bytes() == file.read_bytes() for each in tmp_path.glob("robot_*.xml"))


@pytest.mark.parametrize("members", [0, -3, 10**6])
def test_no_usual_number_of_members_is_refused(members):
    with pytest.raises(InputError, match="expected from 1 to 10000 members"):
        check_ensemble(members)
