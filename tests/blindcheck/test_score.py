"""The score, on answers and diagnoses written by hand: every figure is known beforehand."""

import copy
import json
import math

import numpy as np
import pytest
from answers import FRICTION, RIGHT, answer, diagnosis, said
from scipy.stats import binom

from invdyn.blindcheck.judge import FAILED, OUTSIDE
from invdyn.blindcheck.kinds import KINDS, counted
from invdyn.blindcheck.measures import calibration, mean, median, rate
from invdyn.blindcheck.page import render
from invdyn.blindcheck.score import FIGURES, score
from invdyn.recordings import InputError


def test_wilson_intervals_cover():
    n, p = 60, 0.9
    weights = binom.pmf(range(n + 1), n, p)
    inside = [m.low <= p <= m.high for m in (rate("x", [True] * k + [False] * (n - k)) for k in range(n + 1))]
    assert weights @ inside == pytest.approx(0.9, abs=0.03)
    assert (rate("x", [True] * 5).high, rate("x", [False] * 5).low) == pytest.approx((1.0, 0.0))


def test_means_and_medians():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(400):
        m = median("x", rng.exponential(size=21).tolist())
        hits += m.low <= math.log(2) <= m.high
    # From the 7th to the 15th of 21: binom(21, ½) says how often the middle of the distribution lies between.
    covers = binom.cdf(14, 21, 0.5) - binom.cdf(6, 21, 0.5)
    assert hits / 400 == pytest.approx(covers, abs=4 * np.sqrt(covers * (1 - covers) / 400))
    m = mean("x", [1.0, 2.0, 3.0])
    assert (m.value, m.high - m.value) == pytest.approx((2.0, 1.645 / math.sqrt(3)), rel=1e-3)
    assert mean("x", []).value is None
    assert median("x", [2.0]).low == 2.0


def test_calibration():
    c = calibration([0.95, 0.95, 0.95, 0.95, 0.55, 0.55], [True, True, True, False, True, False])
    assert [(round(p, 2), share, n) for p, share, n in c.bins] == [(0.55, 0.5, 2), (0.95, 0.75, 4)]
    assert c.ece == pytest.approx((2 * 0.05 + 4 * 0.2) / 6)
    assert c.brier == pytest.approx((0.55**2 + 0.45**2 + 3 * 0.05**2 + 0.95**2) / 6)
    assert calibration([1.0], [True]).bins == ((1.0, 1.0, 1),)
    assert calibration([], []).ece is None


def test_a_whole_score():
    wrong = diagnosis((0.9, said("armature", joint="elbow")), side={"dynamics": 1.0}, joints={"shoulder": 1.0})
    answers = {f"right-{i}": answer(FRICTION) for i in range(3)} | {"wrong": answer(FRICTION), "gone": answer(FRICTION)}
    answers |= {f"none-{i}": answer(kind="none") for i in range(4)}
    answers |= {"dark": answer(kind="none", regime="unknown_torque"), "new": answer(FRICTION, kind="outside")}
    found = {f"right-{i}": RIGHT for i in range(3)} | {"wrong": wrong, "new": diagnosis((0.2,), outside=0.8)}
    found |= {f"none-{i}": diagnosis((0.9,), detected=i == 0) for i in range(4)} | {"dark": diagnosis((0.9,))}
    scores = score(answers, found)
    value = lambda kind, name: (scores.measure(kind, name).value, scores.measure(kind, name).n)  # noqa: E731
    assert value("commanded", "a gap is detected") == (0.8, 5)
    assert value("commanded", "first answer right, exactly") == (0.6, 5)
    assert value("commanded", "joint right (two joints or more)") == (0.6, 5)
    assert value("commanded", "side right") == (0.8, 5)
    assert value("commanded", "true parameters in 90 % intervals") == (1.0, 3)
    assert value("commanded", "probability on the true cause (FIA)") == (pytest.approx(0.48), 5)
    assert value("none", "false alarms") == (0.25, 4)
    assert value("none", "false alarms, unknown torque") == (1.0, 1)
    assert value("outside", "flagged as outside the catalogue") == (1.0, 1)
    assert value("all", "no diagnosis") == (1 / 11, 11)
    assert value("all", "wrongly flagged as outside the catalogue") == (0.0, 10)
    assert scores.confusion["viscous_friction"] == {"viscous_friction": 3, "armature": 1, FAILED: 1}
    assert scores.confusion[OUTSIDE] == {OUTSIDE: 1}
    assert not scores.measure("commanded", "a gap is detected").met
    assert scores.measure("outside", "flagged as outside the catalogue").met
    assert json.loads(json.dumps(scores.to_json()))["measures"]["none"][0]["met"] is False
    assert "joint right (two joints or more)" in scores.text()
    assert copy.deepcopy(scores).text() == score(answers, found).text()


def test_the_page_is_whole_and_escapes():
    answers = {"a": answer(FRICTION), "b": answer(kind="none")}
    found = {"a": diagnosis((0.9, said("<script>alert(1)</script>", joint="elbow"))), "b": diagnosis((0.9,))}
    page = render(score(answers, found), {"method": "<b>mine</b>", "seed": 3})
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert "&lt;b&gt;mine" in page
    assert page.count("<table") == page.count("</table>") == 3
    assert render(score(answers, found), {"method": "x"}) == render(score(answers, found), {"method": "x"})
    assert "<table" in render(score({}, {}), {})


def test_counts_of_cases():
    assert set(FIGURES) == set(KINDS)
    everything = counted(None, 200)
    assert sum(everything.values()) == 200
    assert set(everything) == set(KINDS)
    assert everything["commanded"] == 76
    assert counted("commanded,none", 11) == {"commanded": 8, "none": 3}
    assert counted("commanded=200, none=40", 60) == {"commanded": 200, "none": 40}
    assert counted(None, 1) == {"commanded": 1}


@pytest.mark.parametrize("text", ["weird", "none=0", "none=-1", "none=x", "none,none", "none=3,two", ",", "none="])
def test_counts_that_cannot_be(text):
    with pytest.raises(InputError, match="expected"):
        counted(text, 10)
