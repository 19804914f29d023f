"""Where no filter can follow, the linearised model answers, in doubt; else filters do."""

import json

import numpy as np
import pytest
import torch
from grids import grid_posterior
from one_state import Counts

from invdyn.inference import SMCOptions
from invdyn.inference.filters import best_guide
from invdyn.inference.methods import smc as method
from invdyn.inference.posterior.problem import StateSpaceProblem

ROWS = 200
FEW = SMCOptions(num_filters=16, num_particles=1, num_draws=60)


class Started(Counts):
    """Counts of a rate that varies much, of a model that says where its paths lie."""

    sd = 1.5

    def initial_paths(self, observations):
        return torch.zeros(1, len(observations), 1, dtype=torch.float64)


@pytest.fixture
def problem(monkeypatch):
    monkeypatch.setattr(best_guide, "RUN_PARTICLE_STEPS", 0)  # no more particles than asked for
    model = Started(ROWS)
    return StateSpaceProblem(model, model.simulate(seed=3)[1])


@pytest.mark.long
def test_the_linearised_model_answers_where_no_filter_can_follow(problem):
    found = method.smc(problem, options=FEW, seed=0, or_linearised=True)
    assert found.attrs["method"] == "laplace"
    assert "particle filters cannot follow this recording" in json.loads(found.attrs["settings"])["in_doubt"][0]
    exact = grid_posterior(problem.model, problem.observations, -14, 9)
    off = found["posterior"]["state"].values.reshape(-1, ROWS).mean(0) - exact.mean
    assert np.sqrt(np.mean(off**2 / exact.variance)) < 0.15


@pytest.mark.long
def test_filters_answer_where_they_can_or_where_the_linearised_model_is_elsewhere(problem, monkeypatch):
    enough = SMCOptions(num_filters=16, num_particles=100, num_draws=2)
    assert method.smc(problem, options=enough, seed=0, or_linearised=True).attrs["method"] == "smc"
    assert method.smc(problem, options=FEW, seed=0).attrs["method"] == "smc"
    monkeypatch.setattr(method, "bound_doubt", lambda *_: "elsewhere")
    found = method.smc(problem, options=FEW, seed=0, or_linearised=True)
    assert found.attrs["method"] == "smc"
    assert found["sample_stats"].attrs["usable"] == 0
