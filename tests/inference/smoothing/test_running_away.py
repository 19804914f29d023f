"""A step that is not finite is refused, and a model that checks its values, as Pyro's own do, is not asked."""

import sys

import numpy as np
import pytest
import torch
from pyro.distributions import Normal

from invdyn.inference import gauss_newton, posterior_linearisation
from invdyn.models import StateSpaceModel

SMOOTHER, PASS = (
    sys.modules[f"invdyn.inference.smoothing.{name}"] for name in ("gauss_newton", "posterior_linearisation")
)


class Cubic(StateSpaceModel):
    """A point on a hardening spring, with Pyro's default checks of values and a parameter without dimensions."""

    state_dim, observation_dim, num_steps = 1, 1, 8

    def initial(self):
        return Normal(torch.zeros(1, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(state - 0.1 * state**3, self.parameters["noise"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.2).to_event(1)


@pytest.fixture
def seen():
    model = Cubic({"noise": torch.tensor([0.3], dtype=torch.float64)})
    return model, model.simulate()[1]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_gauss_newton_continues_after_a_step_that_is_not_finite(seen, monkeypatch, value):
    expected, steps, whole = gauss_newton(*seen), [], SMOOTHER.mean_and_evidence

    def stray(*arguments, **options):
        steps.append(whole(*arguments, **options))
        mean, *others = steps[-1]
        return (np.full_like(mean, value) if len(steps) == 1 else mean), *others

    monkeypatch.setattr(SMOOTHER, "mean_and_evidence", stray)
    found = gauss_newton(*seen)
    assert len(steps) > 1
    assert found.path.numpy() == pytest.approx(expected.path.numpy(), abs=1e-6)


def test_a_pass_that_runs_away_leaves_the_one_before(seen, monkeypatch):
    smoother = gauss_newton(*seen)
    monkeypatch.setattr(PASS, "forward_mean", lambda *arguments: np.full((8, 1), np.nan))
    assert posterior_linearisation(*seen, smoother) is smoother
