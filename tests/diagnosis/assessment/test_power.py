"""Whether the rows say enough to call a simulation right."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import LOOSE, MANY, PENDULUM, recorded

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment.power import too_little
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


def film(fps, seconds):
    """A pendulum that lacks nothing, in so many rows."""
    arm = random_arm(PENDULUM, duration=seconds, fps=fps, noise=0.0005, torque_scale=0.7, commanded=True, seed=3)
    return record(arm, 3)[0]


@pytest.mark.quick("2000-*")
@pytest.mark.parametrize(("fps", "seconds"), [(2000, 0.012), (1000, 0.1)])
def test_in_a_moment_nobody_sees_what_is_missing(fps, seconds):
    """However many rows there are of it."""
    said = diagnose(film(fps, seconds), PENDULUM, without=MANY)
    assert not said.gap.detected
    assert not said.causes
    assert f"in {round(fps * seconds)} rows of " in said.not_enough_data
    assert "N·m could be missing and not show; give a longer recording" in said.not_enough_data


def test_in_a_second_it_shows():
    said = diagnose(film(100, 1.5), PENDULUM, without=MANY)
    assert said.not_enough_data is None
    assert said.gap.probability < 0.1


@pytest.mark.quick("loss0-*", "loss3-*")
@pytest.mark.parametrize(
    ("loss", "hidden"),
    [
        ((0, 1, 2, 3, 3.1, 3.1, 50), None),
        ((0, 0, 0, 0, 0, 2.9, 50), 5),
        ((0, 0, 0, 0, 0, 2.9, 2.9), 6),
        ((0, 0, 0, 0, 0, -2.9, 50), 5),
        ((0, 1, 2, 3, 3, -3.1, 0), None),  # something surely is missing
        ((0, 1, 2, -3.1, 3, 0, 0), None),
    ],
)
def test_a_large_torque_must_be_out_of_the_question(loss, hidden):
    bound = diagnosis_problem(recorded(), PENDULUM)
    path, stray = data_path(bound)
    none, levels = refine(bound, (), {}, path, LOOSE, rounds=1), COMMANDED.sizes
    none = replace(none, by_size=bound.regime.log_prior - np.array(loss, dtype=float))
    found = HypothesisPool(bound, considered(bound), {"": none}, [], path, stray)
    assert DEFAULT.evidence.ruled_out_gap == 3.0
    said = too_little(bound, found)
    if hidden is None:
        assert said is None
    else:
        assert f"in 80 rows of 1.6 s a torque of {levels[hidden] * bound.typical.max().item():.2g} N·m" in said
    # An effect that was found is one, however little else would have shown.
    friction = refine(bound, (EFFECTS["viscous_friction"]("pivot"),), {}, path, LOOSE, rounds=1)
    found.add(replace(friction, log_evidence=none.log_evidence + 100.0))
    assert too_little(bound, found) is None


def test_an_unknown_torque_may_be_of_any_size():
    bound = diagnosis_problem(replace(film(1000, 0.1), torques=None), PENDULUM)
    path, stray = data_path(bound)
    none = refine(bound, (), {}, path, bound.regime.path_size, rounds=1)
    assert too_little(bound, HypothesisPool(bound, considered(bound), {"": none}, [], path, stray)) is None
