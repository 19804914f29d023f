"""One effect less."""

import sys
from dataclasses import replace

import pytest
from pendulum import LOOSE, PENDULUM, driven
from variants import nonideal

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.search import drop
from invdyn.diagnosis.hypotheses.swap import without
from invdyn.diagnosis.problem.cause import key_of
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS


def test_a_set_loses_what_it_does_not_need():
    """From friction and a spring that is not there, friction alone."""
    bound = diagnosis_problem(driven("viscous_friction", viscous_friction_damping=0.1), PENDULUM)
    path, stray = data_path(bound)
    effects = tuple(EFFECTS[name]("pivot") for name in ("viscous_friction", "joint_stiffness"))
    none, both = refine(bound, (), {}, path, LOOSE), refine(bound, effects, {}, path, LOOSE)
    found = HypothesisPool(bound, considered(bound), {"": none, both.key: both}, [], path, stray)
    assert found.ranked[0].key == both.key
    drop(found, found.ranked[0])
    assert found.ranked[0].key == "viscous_friction.pivot"


def test_the_variant_of_one_takes_the_place_of_two(monkeypatch):
    """What stands beside ideal friction stands for what that lacks, though by itself it leaves nothing either."""
    bound = diagnosis_problem(driven(), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    by_name = {effect.name: effect for effect in considered(bound)}
    friction, other = by_name["coulomb_friction"], by_name["armature"]
    soft = nonideal(friction)
    gains = {(friction,): 90.0, (friction, other): 100.0, (other,): 0.0, (soft,): 95.0}
    causes = {
        effects: replace(none, effects=effects, log_evidence=none.log_evidence + gain)
        for effects, gain in gains.items()
    }
    tried = []

    def regularised(problem, cause, mine, **limits):
        tried.append((cause.key, mine.key))
        return causes[soft,] if mine is friction and len(cause.effects) == 1 else None

    monkeypatch.setattr(sys.modules[drop.__module__], "without", lambda _, whole, effect, size: None)
    monkeypatch.setattr(sys.modules["invdyn.diagnosis.hypotheses.swap"], "regularised", regularised)
    pool = {causes[effects].key: causes[effects] for effects in ((friction,), (friction, other), (other,))}
    found = HypothesisPool(bound, considered(bound), {"": none, **pool}, [], path, stray)
    assert found.ranked[0].key == key_of((friction, other))
    assert found.pool[friction.key].complete
    drop(found, found.ranked[0])
    assert tried == [(friction.key, friction.key)]
    assert found.ranked[0] is causes[soft,]


def test_what_was_searched_is_tried_without_the_rest(monkeypatch):
    """Beside outliers a coupling of no stiffness may have been what their parameters needed to be searched on."""
    bound = diagnosis_problem(driven(), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    pair = tuple(e for e in considered(bound) if e.name in ("outliers", "viscous_friction"))
    both = replace(none, effects=pair, log_evidence=none.log_evidence + 100, noise_sd={"rate": 0.1})
    both = replace(both, noise_log={"outliers": -3.0})
    tried = {}

    def refined(problem, effects, values, path, size, **kept):
        tried[tuple(e.name for e in effects)] = kept

    monkeypatch.setattr(sys.modules[without.__module__], "refine", refined)
    drop(HypothesisPool(bound, considered(bound), {"": none, both.key: both}, [], path, stray), both)
    assert tried == {("outliers",): both.searched, ("viscous_friction",): both.searched}


def test_what_is_left_of_two_that_were_searched_is_searched_anew():
    """Beside the other it may have had another size and spread; none of the other's integral stays."""
    bound = diagnosis_problem(driven(), PENDULUM)
    seen = bound.observations.clone()
    seen[[11, 30, 52, 63]] += 0.1
    bound = bound.observing(seen)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    by_name = {e.name: e for e in considered(bound)}
    outliers, mistimed = by_name["outliers"], by_name["timestamp_jitter"]
    one = refine_searched(bound, none, outliers)
    both = replace(one, effects=(*one.effects, mistimed), noise=one.noise | {f"{mistimed.key}.rate": 0.5})
    both = replace(both, noise=both.noise | {f"{mistimed.key}.sd": 0.001})
    both = replace(both, noise_log=one.noise_log | {mistimed.key: -5.0})
    left = without(bound, both, mistimed, DEFAULT.residual.min_path_size)
    assert left.key == outliers.key
    assert set(left.noise_sd) == set(left.noise) == set(one.noise)
    assert left.noise_log == {outliers.key: pytest.approx(one.noise_log[outliers.key], abs=0.5)}
    assert left.log_evidence == pytest.approx(one.log_evidence, abs=0.5)
