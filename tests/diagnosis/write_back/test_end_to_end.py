"""A log against a robot's own file: the change is named, and the corrected copy rolls out as the log does."""

import json
import re

import numpy as np
import pytest
from robot_xml import play, robot

from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.report.numbers import handy
from invdyn.diagnosis.report.save import save
from invdyn.diagnosis.report.sentences import details
from invdyn.diagnosis.write_back.ensemble import write_ensemble
from invdyn.diagnosis.write_back.write_back import check_write_back, write_back
from invdyn.models import Body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError

pytestmark = pytest.mark.filterwarnings("ignore:.*clockwise")
KEPT = ("viscous_friction", "armature", "actuator_gain")
"""Effects that are looked for: the whole catalogue takes long, and shows no more."""


def test_damping_of_a_file_is_corrected(tmp_path):
    file, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    file.write_text(robot())
    body = Body.load(file)
    true = robot().replace('damping="0.1"', 'damping="0.35"')
    log, held_out = (play(true, 3.0, seed).at(slice(None, None, 2)) for seed in (0, 1))
    found = diagnose(log, body, without=[name for name in EFFECTS if name not in KEPT], most=1)
    written = write_back(found, file, body, copy, held_out, True)
    (change,) = written.written.changes
    assert (change["place"], change["quantity"], change["from"]) == ("elbow", "damping", 0.1)
    assert change["to"] == pytest.approx(0.35, rel=0.03)
    assert change["interval_90"][0] < change["to"] < change["interval_90"][1]
    angles = written.written.rollout["total_rms_rad"]
    assert angles["after"] < 0.15 * angles["before"]
    assert any("changes from 0.100 to" in sentence for sentence in details(written))
    save(written, tmp_path)
    said = json.loads((tmp_path / "diagnosis.json").read_text())
    damping = said["causes"][0]["effects"][0]["parameters"]["damping"]
    assert damping["from"] == 0.1
    assert damping["to"] == pytest.approx(change["to"])
    assert said["write_back"]["rollout"]["held_out"]
    row = (tmp_path / "report.html").read_text().partition("The corrected file")[2].partition("</tbody>")[0]
    told = re.search(r"damping of elbow, N·m·s/rad</th>\D*>([\d.]+)</td>\D*>([\d.]+)</td>", row)
    assert [float(number) for number in told.groups()] == pytest.approx([0.1, change["to"]], rel=1e-3)
    replayed = next(sentence for sentence in details(written) if "replayed a withheld recording" in sentence)
    said_of = [f"by {handy(angles[which], 'rad')}" for which in ("after", "before")]
    assert replayed.index(said_of[0]) < replayed.index("with the corrected file") < replayed.index(said_of[1])
    (tmp_path / "robots").mkdir()
    (number,) = write_ensemble(found, file, body, tmp_path / "robots", 200)["numbers"]
    assert (number["place"], number["quantity"]) == ("elbow", "damping")
    # 200 draws of the interval's own Gaussian
    width = change["interval_90"][1] - change["interval_90"][0]
    assert number["mean"] == pytest.approx(change["to"], abs=4 * number["sd"] / np.sqrt(200))
    assert number["range_90"][1] - number["range_90"][0] == pytest.approx(width, rel=0.25)


@pytest.mark.long
def test_a_robots_file_follows_the_regression_where_that_is_the_answer(tmp_path):
    """Joints lack damping and dry friction, and the budget begins no search."""
    file, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    file.write_text(robot())
    body = Body.load(file)
    true = robot().replace('damping="0.1"', 'damping="0.35" frictionloss="0.3"')
    true = true.replace('damping="0.3"', 'damping="0.6"')
    log, held_out = (play(true, 3.0, seed).at(slice(None, None, 2)) for seed in (0, 1))
    found = diagnose(log, body, without=[name for name in EFFECTS if name not in KEPT], robot=True, budget=0.1)
    assert found.closing.shown == "regression"
    written = write_back(found, file, body, copy, held_out, True).written
    to = {(each["place"], each["quantity"]): each["to"] for each in written.changes}
    numbers = {(e.place, e.parameter): e.value for e in found.regression.numbers if e.effect == "viscous_friction"}
    assert to["elbow", "damping"] == pytest.approx(0.1 + numbers["elbow", "damping"])
    assert to["shoulder", "damping"] == pytest.approx(0.3 + numbers["shoulder", "damping"])
    assert written.rollout["total_rms_rad"]["after"] < 0.3 * written.rollout["total_rms_rad"]["before"]
    (tmp_path / "robots").mkdir()
    ranges = write_ensemble(found, file, body, tmp_path / "robots", 50)["numbers"]
    drawn = {(n["place"], n["quantity"]): n["mean"] for n in ranges}
    assert drawn["elbow", "damping"] == pytest.approx(to["elbow", "damping"], abs=0.1)


def test_a_name_that_would_not_serve_is_refused_before_the_work(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text(robot())
    with pytest.raises(InputError, match="paper_planar_arm is no file, and only a file has a copy"):
        check_write_back("paper_planar_arm", tmp_path / "out.toml")
    with pytest.raises(InputError, match=r"expected a name that ends in \.xml"):
        check_write_back(file, tmp_path / "out.toml")
    file.write_text(robot().replace("<worldbody>", '<asset><mesh file="a.stl"/></asset><worldbody>', 1))
    with pytest.raises(InputError, match="the same folder"):
        check_write_back(file, tmp_path.parent / "out.xml")
