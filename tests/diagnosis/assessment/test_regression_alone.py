"""A diagnosis whose regression finds gains far from the file's: no search, and a file that MuJoCo's replays correct."""

import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from far_servos import FILE, STATED, log

from invdyn.diagnosis.assessment.result import Cause, Estimate, Finding
from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.report.report import render
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.diagnosis.write_back.ensemble import write_ensemble
from invdyn.diagnosis.write_back.output_error import refine
from invdyn.diagnosis.write_back.write_back import write_back
from invdyn.models import Body

pytestmark = pytest.mark.long  # one diagnosis of 12 CPU s for all


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(FILE.format(**STATED))
    return path, Body.load(path)


@pytest.fixture(scope="module")
def found(arm):
    _, body = arm
    logs = [log(body, 1850, 1), log(body, 1850, 2)]
    with pytest.warns(UserWarning, match="the servos' gains in the robot's file are .* too large"):
        return logs, diagnose(logs, body, robot=True)


def test_the_verdict_is_the_regressions(found):
    _, diagnosis = found
    assert diagnosis.gap.detected
    assert not diagnosis.causes
    assert set(diagnosis.regression.far_gains) == {"shoulder", "elbow"}
    for factor in diagnosis.regression.far_gains.values():
        assert 0.02 < factor < 0.08  # 12 of 300 in truth
    assert verdict(diagnosis).startswith("By regression alone there is a gap: ")
    assert "actuator gain at all joints" in verdict(diagnosis)
    assert "of the missing torque" in verdict(diagnosis)


def test_it_says_that_no_causes_were_searched_for(found):
    _, diagnosis = found
    said = details(diagnosis)[0]
    assert said.startswith("No causes were searched for: the log shows")
    assert "times the file's" in said
    assert "diagnose the corrected copy" in said


def test_its_page_and_json_are_whole(found):
    _, diagnosis = found
    page = render(diagnosis)
    assert "No causes were searched for" in page
    assert json.loads(json.dumps(diagnosis.to_json()))["regression"]["statements"]


def test_a_fit_that_the_file_cannot_say_is_not_written(arm, found, tmp_path):
    """A gain by `dampratio` is no number of its own: the regression's numbers that the file has are written."""
    path, body = arm
    logs, diagnosis = found
    source = path.with_name("ratio.xml")
    source.write_text(path.read_text().replace('kv="1"', 'dampratio="1"'))
    refused, said = (
        FileChange("elbow", what, 1.0, 0.5, (0.4, 0.6), "1", "output error") for what in ("servo gain", "friction")
    )
    fit = SimpleNamespace(changes=(refused, said), to_json=dict)
    written = write_back(diagnosis, source, body, tmp_path / "new.xml", logs[0], False, fit).written
    assert written.refined is None
    assert "output error" not in {change["effect"] for change in written.changes}


def test_it_says_why_nothing_is_written(arm, found, tmp_path):
    path, body = arm
    logs, diagnosis = found
    much = Estimate(1e3, 1.0, (999.0, 1001.0), "N·m·s/rad")
    entry = CATALOGUE["viscous_friction"]
    finding = Finding("viscous_friction", "dynamics", {"joint": "elbow"}, {"damping": much}, {}, entry)
    wrong = replace(diagnosis, regressed=Cause((finding,), 0.0, float("nan"), float("nan")))
    written = write_back(wrong, path, body, tmp_path / "new.xml", logs[0], False)
    assert not (tmp_path / "new.xml").exists()
    (said,) = [sentence for sentence in details(written) if sentence.startswith("No corrected file was written")]
    assert "MuJoCo replays the file that the regression corrects no better" in said


def test_the_corrected_file_and_the_ensemble_are_the_output_error_fits(arm, found, tmp_path):
    path, body = arm
    logs, diagnosis = found
    fit = refine(diagnosis, path, body, logs, members=6)
    assert fit is not None
    written = write_back(diagnosis, path, body, tmp_path / "new.xml", logs[0], False, fit)
    tried = written.written.rollout["total_rms_rad"]
    assert tried["after"] < 0.2 * tried["before"]
    assert any("held-out windows of 8 s" in sentence for sentence in details(written))
    assert {change["effect"] for change in written.written.changes} == {"output error"}
    ranges = write_ensemble(diagnosis, path, body, tmp_path, 6, fit)
    gains = [each for each in ranges["numbers"] if each["quantity"] == "servo gain"]
    assert {each["place"] for each in gains} == {"shoulder", "elbow"}
    assert len({(tmp_path / f"robot_{n:03d}.xml").read_bytes() for n in range(6)}) == 6
