"""A candidate that diverges is none; a slip in an effect is no candidate that failed, and surfaces."""

import numpy as np
import pytest
import torch
from pendulum import LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models.divergence import Diverged
from invdyn.models.effects import ViscousFriction
from invdyn.models.effects.composition import NotTogether


def refined(effects, values):
    bound = diagnosis_problem(recording_of(), PENDULUM)
    return attempt(refine, bound, effects, values, data_path(bound)[0], LOOSE, rounds=1)


@pytest.mark.parametrize(
    ("slip", "error", "match"),
    [
        (lambda speed: speed.numpy() @ np.ones(3), ValueError, "mismatch"),
        (lambda speed: np.linalg.inv(np.ones((2, 3))), np.linalg.LinAlgError, "square"),
        (lambda speed: speed @ torch.ones(7, 1).double(), RuntimeError, "shapes"),
    ],
    ids=["numpy", "no square matrix", "torch"],
)
def test_a_wrong_shape_in_an_effect_surfaces(slip, error, match):
    class Slipping(ViscousFriction):
        def force(self, p, now):
            return torch.as_tensor(slip(now.qd))

    with pytest.raises(error, match=match) as caught:
        refined((Slipping("pivot"),), {"slipping:pivot.damping": 0.1})
    assert not isinstance(caught.value, Diverged)


def test_a_simulation_that_runs_away_is_no_candidate():
    class Runaway(ViscousFriction):
        def force(self, p, now):
            return now.qd * torch.inf

    assert refined((Runaway("pivot"),), {"runaway:pivot.damping": 0.1}) is None


def test_effects_that_no_model_has_together_are_no_candidate():
    def together():
        raise NotTogether("two of a kind")

    assert attempt(together) is None
    with pytest.raises(ValueError, match="another"):
        attempt(lambda: (_ for _ in ()).throw(ValueError("another")))
