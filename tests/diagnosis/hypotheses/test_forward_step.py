"""One more effect beside a base: which ones are searched for there, and how good they have to be."""

import sys
from dataclasses import replace

import pytest
from pendulum import LOOSE, PENDULUM, recorded, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.forward_step import extend
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import TOO_FAR_BEHIND
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models.effects import EFFECTS


@pytest.mark.parametrize("left", [True, False])
def test_what_no_torque_explains_has_a_cause_that_the_camera_shows(monkeypatch, left):
    """Where errors of prediction show that something is left, what a torque's prior is wrong about is no bar to it."""
    module, asked = sys.modules[extend.__module__], []
    bound = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, bound.regime.loose, rounds=1)
    monkeypatch.setattr(module, "show_more", lambda *_: left)
    monkeypatch.setattr(module, "refine_promising", lambda *_: None)
    monkeypatch.setattr(module, "refine_barred", lambda *_: asked.append("barred"))
    monkeypatch.setattr(module, "idle", lambda _: none.log_evidence + 500.0)
    monkeypatch.setattr(module, "refine_searched", lambda *given: asked.append(round(given[3] - none.log_evidence)))
    extend(bound, HypothesisPool(considered(bound), {"": none}, [], path, stray), none, 1)
    assert asked[0] == ("barred" if left else 500)
    assert set(asked[left:]) == {-TOO_FAR_BEHIND if left else 500}


@pytest.mark.parametrize(("damping", "large", "looked"), [(0.0, 10.0, True), (0.05, 10.0, False), (0.05, 60.0, True)])
def test_play_is_looked_for_where_no_other_effect_explains_the_gap(monkeypatch, damping, large, looked):
    """A rigid arm follows small play without a residual torque: that nothing is left does not speak against play.

    Friction that explains a ``large`` gap, in nats, does; here it gains 19.
    """
    tried, module = [], sys.modules[extend.__module__]
    bound = diagnosis_problem(recorded(damping), PENDULUM)
    path, stray = data_path(bound)
    friction = EFFECTS["viscous_friction"]("pivot")
    none, found = (refine(bound, effects, {}, path, LOOSE) for effects in ((), (friction,)))
    pool = HypothesisPool(considered(bound), {none.key: none}, [], path, stray, aside=path)

    def refined(_, pool, base, best, width):
        pool.add(found)

    monkeypatch.setattr(module, "TOO_FAR_BEHIND", large)
    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append(given[2].name))
    monkeypatch.setattr(module, "refine_promising", refined)
    monkeypatch.setattr(module, "refine_kin", lambda *_: None)
    extend(bound, pool, none, 1)
    assert pool.ranked[0].complete
    assert ("backlash" in tried) is looked


@pytest.mark.parametrize(
    ("other", "strays", "ahead", "looked"),
    [
        ("viscous_friction", -1.0, 0.0, True),
        ("viscous_friction", -1.0, 200.0, True),
        ("coulomb_friction", -1.0, 0.0, False),
        ("viscous_friction", 100.0, 0.0, False),
    ],
)
def test_play_is_looked_for_beside_one_other_effect_that_does_not_stick(monkeypatch, other, strays, ahead, looked):
    """Where that one leaves something: a spring, which is not in it; however little a grid along its path shows.

    Beside one that is far behind another cause it must make good a tenth of that there. Not where stray detections
    alone explain more than that one does.
    """
    tried, module = [], sys.modules[extend.__module__]
    spring = EFFECTS["joint_stiffness"]("pivot")
    bound = diagnosis_problem(recording_of(spring, stiffness=1.0, torque=0.5), PENDULUM)
    path, stray = data_path(bound)
    none, base = (refine(bound, effects, {}, path, LOOSE, rounds=2) for effects in ((), (EFFECTS[other]("pivot"),)))
    assert not base.complete
    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append((given[2].name, given[3])))
    monkeypatch.setattr(module, "refine_promising", lambda *_: None)
    astray = replace(base, effects=(EFFECTS["outliers"]().bound(PENDULUM),), log_evidence=base.log_evidence + strays)
    better = replace(base, effects=(spring.bound(PENDULUM),), log_evidence=base.log_evidence + ahead)
    found = HypothesisPool(considered(bound), {c.key: c for c in (none, astray, base, better)}, [], path, stray)
    extend(bound, found, base, 1)
    enough = [least for name, least in tried if name == "backlash"]  # others that join the base gain less than a nat
    assert enough == pytest.approx([base.log_evidence + ahead / 10] * looked, abs=0.5)
