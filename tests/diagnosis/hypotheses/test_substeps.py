"""Sub-steps whose error costs no evidence."""

from dataclasses import replace
from functools import cache

import pytest
from pendulum import ARM, LOOSE

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.laws import finely_stepped
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
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


@pytest.mark.long
def test_errors_of_integration_cost_no_evidence():
    """They would, dozens of nats, which an effect that is integrated in shorter steps would then have gained."""
    coarse = diagnosis_problem(seen(), ARM).in_substeps(1)
    fine = finely_stepped(coarse, data_path(coarse)[0])
    assert 1 < fine.model.substeps <= DEFAULT.search.max_step_factor
    assert coarse.model.substeps == 1
    exact = evidence(coarse.in_substeps(16))
    assert abs(evidence(fine) - exact) < 2.0
    assert evidence(coarse) < exact - 50.0
    assert finely_stepped(fine, data_path(fine)[0]).model.substeps == fine.model.substeps


@pytest.mark.long
def test_a_limbs_own_torque_takes_errors_along():
    here = diagnosis_problem(replace(seen(), torques=None), ARM).in_substeps(1)
    assert finely_stepped(here, data_path(here)[0]) is here
