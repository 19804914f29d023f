"""A right linear model of any size, from which tests of the contract make wrong ones."""

import pyro.distributions as dist
import pytest
import torch
from pyro.distributions import Normal

from invdyn.inference import (
    Bootstrap,
    ModelError,
    ParticleFilter,
)
from invdyn.models import StateSpaceModel

F64 = torch.float64


class Right(StateSpaceModel):
    """x' = 0.8 x + N(0, noise²), y = x_1 + … + x_D in each entry, + N(0, error²)."""

    def __init__(self, dim=2, width=2, steps=6, dtype=F64):
        super().__init__({"noise": torch.tensor(0.5, dtype=dtype), "error": torch.tensor(0.3, dtype=dtype)})
        self.state_dim, self.observation_dim, self.num_steps = dim, width, steps

    def initial(self):
        return Normal(torch.zeros(self.state_dim, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(0.8 * state, self.parameters["noise"]).to_event(1)

    def seen(self, state):
        return state.sum(-1, keepdim=True).expand(*state.shape[:-1], self.observation_dim)

    def emission(self, state, t):
        return Normal(self.seen(state), self.parameters["error"]).to_event(1)


def normal(mean, scale=0.5, **options):
    return Normal(mean, scale, **options).to_event(1)


def poisson(model, state, t):
    return dist.Poisson(model.seen(state).clamp(-5, 5).exp()).to_event(1)


def by_filter(model, rows):
    return ParticleFilter(model, Bootstrap(model), 5, num_filters=2).run(rows)


def line(way, model, rows):
    """The message, which must be one line."""
    with pytest.raises(ModelError) as caught:
        way(model, rows)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    expected, _, got = message.partition(", got ")
    assert ": expected " in expected
    assert ": " in got  # and the usual fix
    return message


class StateNoise(Right):
    """The covariance grows with the state."""

    def transition(self, state, t):
        return normal(0.8 * state, 0.3 + 0.1 * state.abs())


class Jumps(Right):
    def transition(self, state, t):
        return dist.StudentT(4.0, 0.8 * state, 0.5).to_event(1)


class Positive(Right):
    def initial(self):
        return dist.Gamma(torch.ones(self.state_dim, dtype=F64), 1.0).to_event(1)
