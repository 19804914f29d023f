"""Sets of effects by a beam search: what it returns, and that it names two that are at work together."""

import numpy as np
import pytest
import torch

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.prior import MOST_EFFECTS, log_prior_of
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.beam_search import together
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models import Body, Link
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.backlash import Backlash
from invdyn.simulate import random_arm, record

ROD = Link("rod", "pivot", "tip", length=0.3, mass=1.0)
PENDULUM = Body("pendulum", [ROD], gravity=(0.0, -9.81))
TRUTH = {"viscous_friction.pivot": {"damping": 0.08}, "payload": {"mass": 0.1}}


@pytest.fixture(scope="module")
def sets():
    """Pairs, triples, … of a pendulum with friction and a payload, and all that was looked at."""
    arm = random_arm(PENDULUM, duration=2.0, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    for key, values in TRUTH.items():
        name, *where = key.split(".")
        named = {f"effect.{key}.{n}": torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
        arm = arm.with_effects(EFFECTS[name](*where)).replace(**named)
    bound = diagnosis_problem(record(arm, 0)[0], PENDULUM)
    path, _ = data_path(bound)
    candidates = considered(bound)
    common = unknowns(bound, ())
    straight = [e for e in candidates if not isinstance(e, Backlash)]
    screened = screen(bound, bound.model, path, straight, common, common.mean)
    arguments = (bound, bound.model, path, screened, common)
    return together(*arguments, candidates, 3), bound, arguments


def test_sets_come_by_number_and_the_best_first(sets):
    found, bound, _ = sets
    assert 1 <= len(found) <= MOST_EFFECTS - 1
    for number, of_number in enumerate(found, 2):
        assert 1 <= len(of_number) <= 3
        assert [s.score for s in of_number] == sorted((s.score for s in of_number), reverse=True)
        for each in of_number:
            assert len({effect.key for effect in each.effects}) == len(each.effects) == number
            assert each.size in bound.regime.sizes


def test_two_at_work_are_among_the_best_pairs(sets):
    found, *_ = sets
    pairs = {frozenset(effect.key for effect in each.effects): each for each in found[0]}
    assert frozenset(TRUTH) in pairs
    values = pairs[frozenset(TRUTH)].values
    # Linearised about their absence, which refining mends.
    assert 0.5 < values["viscous_friction.pivot.damping"] / 0.08 < 2
    assert 0.5 < values["payload.mass"] / 0.1 < 2


def test_scores_have_the_prior_of_what_is_considered(sets):
    found, bound, arguments = sets
    truth = [e for e in considered(bound) if e.key in TRUTH]
    few = together(*arguments, truth, 3)
    mine, theirs = (
        next(each for each in some[0] if {effect.key for effect in each.effects} == set(TRUTH)) for some in (found, few)
    )
    more = log_prior_of(truth, truth) - log_prior_of(truth, considered(bound))
    assert more > 5
    assert theirs.score - mine.score == pytest.approx(more)


def test_parameters_are_plausible(sets):
    found, bound, _ = sets
    for each in (each for of_number in found for each in of_number):
        among = unknowns(bound, each.effects)
        values = np.array([each.values.get(name, mean) for name, mean in zip(among.names, among.mean, strict=True)])
        assert (values <= among.upper + 1e-9).all()
        assert (values >= among.lower - 1e-9).all()
