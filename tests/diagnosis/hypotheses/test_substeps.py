"""Sub-steps whose error costs no evidence."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pendulum import ARM, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses import substeps
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.substeps import MOST_TIMES, finely_stepped, shortened
from invdyn.diagnosis.problem.diagnosis_problem import LOOSE, DiagnosisProblem, diagnosis_problem
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record


@cache
def seen() -> Recording:
    """An arm that nothing is missing from, by an integrator that hardly errs."""
    arm = random_arm(ARM, duration=6.0, fps=50, noise=0.0003, torque_scale=0.3, commanded=True, seed=0)
    arm = arm.in_substeps(64)
    return record(arm, 0)[0]


def evidence(here: DiagnosisProblem) -> float:
    return refine(here, (), {}, data_path(here)[0], LOOSE).log_evidence


def test_errors_of_integration_cost_no_evidence():
    """They would, dozens of nats, which an effect that is integrated in shorter steps would then have gained."""
    coarse = diagnosis_problem(seen(), ARM).in_substeps(1)
    fine = finely_stepped(coarse, data_path(coarse)[0])
    assert 1 < fine.model.substeps <= MOST_TIMES
    assert coarse.model.substeps == 1
    exact = evidence(coarse.in_substeps(16))
    assert abs(evidence(fine) - exact) < 2.0
    assert evidence(coarse) < exact - 50.0
    assert finely_stepped(fine, data_path(fine)[0]).model.substeps == fine.model.substeps


def test_a_limbs_own_torque_takes_errors_along():
    here = diagnosis_problem(replace(seen(), torques=None), ARM).in_substeps(1)
    assert finely_stepped(here, data_path(here)[0]) is here


@pytest.mark.parametrize(
    ("key", "complete", "finer", "taken"),
    [
        ("stribeck_friction.pivot", False, (False, False), None),
        ("stribeck_friction.pivot", False, (True, True), 2),
        ("stribeck_friction.pivot", False, (False, True), 4),  # half as long steps are not short enough
        ("stribeck_friction.pivot", True, (True, True), None),  # it leaves nothing
        ("viscous_friction.pivot", False, (True, True), None),  # its force does not jump
        ("coulomb_friction.pivot+stribeck_friction.pivot", False, (True, True), None),
    ],
)
@pytest.mark.parametrize("gain", [50.0, -50.0])
def test_what_jumps_may_leave_nothing_in_shorter_steps(monkeypatch, key, complete, finer, taken, gain):
    bound = diagnosis_problem(recording_of(rows=120), PENDULUM).in_substeps(4)
    path, stray = data_path(bound)
    effects = {e.key: e for e in considered(bound)}
    none = refine(bound, (), {}, path, LOOSE, rounds=1)
    mine = [effects[each].softened() or effects[each] for each in key.split("+")]
    cause = refine(bound, mine, {}, path, LOOSE, rounds=1)
    assert cause.model.substeps_taken == 4
    spike = np.arange(len(none.by_size)) == 0
    left, nothing = np.where(spike, -100.0, 0.0), np.where(spike, 0.0, -100.0)
    cause = replace(cause, by_size=nothing if complete else left, log_evidence=none.log_evidence + 100.0)
    tried = []

    def refined(there, given, values, start, size):
        assert start is path
        assert values == cause.values
        assert [effect.softness for effect in given] == [0]
        by_size = nothing if finer[len(tried)] else left
        tried.append(there.model.substeps)
        evidence = cause.log_evidence + gain
        return replace(cause, effects=tuple(given), model=there.model, by_size=by_size, log_evidence=evidence)

    monkeypatch.setattr(substeps, "refine", refined)
    found = HypothesisPool(list(effects.values()), {c.key: c for c in (none, cause)}, [], path, stray)
    there = shortened(bound, found)
    asked = not complete and key == "stribeck_friction.pivot"
    if taken and gain > 0:
        assert there.model.substeps == found.ranked[0].model.substeps == 4 * taken
        assert found.ranked[0].complete
        assert tried == [8, 16][: taken // 2]
    else:
        assert there is bound
        assert found.ranked[0] is cause
        assert tried == ([8, 16] if asked else [])
