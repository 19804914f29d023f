"""State-space models of one state, for :mod:`gallery`: each changes what is seen of a state, or how it moves.

``answer`` and ``grid`` say how exact answers are found (:mod:`gallery_answers`). Shapes: states (..., 1), rows (T, 1).
"""

import math

import torch
from pyro.distributions import Bernoulli, Distribution, Gamma, Normal, Poisson, StudentT, VonMises
from torch import Tensor

from invdyn.models import StateSpaceModel

T = 50
F64 = torch.float64


def number(value) -> Tensor:
    return torch.as_tensor(value, dtype=F64)


class Autoregression(StateSpaceModel):
    """x_t = ρ x_{t−1} + N(0, sd²), stationary; variants change what is seen of it, or its noise."""

    answer, grid = "grid", (-8.0, 8.0, 640)
    state_dim = observation_dim = 1
    num_steps = T
    rho, sd = 0.9, 0.5

    def __init__(self):
        super().__init__({"sd": number(self.sd)})

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), self.sd / math.sqrt(1 - self.rho**2)).to_event(1)

    def transition(self, state, t) -> Distribution:
        return Normal(self.rho * state, self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.5).to_event(1)


class Volatility(Autoregression):
    """Taylor (1982): returns of mean zero, whose log-variance is the state."""

    rho, sd = 0.95, 0.3

    def emission(self, state, t):
        return Normal(torch.zeros_like(state), (state / 2).exp()).to_event(1)


class Leverage(Volatility):
    """Harvey & Shephard (1996): a return's shock is correlated by −.7 with the next change of volatility."""

    correlation = -0.7

    def emission_given(self, previous, state, t):
        shock = (state - self.rho * previous) / self.parameters["sd"]
        scale = (previous / 2).exp()
        return Normal(self.correlation * shock * scale, math.sqrt(1 - self.correlation**2) * scale).to_event(1)


class Growth(Autoregression):
    """Gordon, Salmond & Smith (1993): the sign of the state is hardly seen."""

    grid = (-40.0, 40.0, 800)

    def __init__(self):
        StateSpaceModel.__init__(self, {"sd": number(math.sqrt(10.0))})

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), math.sqrt(5.0)).to_event(1)

    def transition(self, state, t):
        t = torch.as_tensor(t, dtype=state.dtype)
        drive = 8 * torch.cos(1.2 * (t.unsqueeze(-1) if t.ndim else t))
        return Normal(state / 2 + 25 * state / (1 + state**2) + drive, self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(state**2 / 20, 1.0).to_event(1)


class Nutria(Autoregression):
    """Log-abundance that grows by Gompertz's law, as of trapped nutria; log-counts with Student-t errors."""

    grid = (-1.0, 9.0, 640)

    def initial(self):
        return Normal(torch.full((1,), 3.0, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(0.8 + 0.8 * state, 0.4 * self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return StudentT(4.0, state, 0.25).to_event(1)


class Cox(Autoregression):
    """Counts whose log-rate is the state."""

    def emission(self, state, t):
        return Poisson((state + 0.5).exp()).to_event(1)


class Binary(Autoregression):
    def emission(self, state, t):
        return Bernoulli(logits=2 * state).to_event(1)


class Directions(Autoregression):
    """Angles around the state, wrapped, by von Mises."""

    def emission(self, state, t):
        return VonMises(state, torch.full_like(state, 4.0)).to_event(1)


class GammaSteps(Autoregression):
    """A positive state: no Gaussian transition."""

    grid = (1e-3, 12.0, 900)

    def initial(self):
        return Gamma(torch.full((1,), 4.0, dtype=self.dtype), 4.0).to_event(1)

    def transition(self, state, t):
        mean = 0.2 + 0.8 * state
        return Gamma(torch.full_like(mean, 8.0), 8 / mean).to_event(1)


class HeavySteps(Autoregression):
    """Student-t steps, of three degrees of freedom: the level jumps now and then."""

    grid = (-20.0, 20.0, 800)

    def transition(self, state, t):
        return StudentT(3.0, self.rho * state, 0.5 * self.parameters["sd"]).to_event(1)


class GrowingNoise(Autoregression):
    """The noise grows with the state."""

    def transition(self, state, t):
        return Normal(self.rho * state, 0.1 + 0.6 * self.parameters["sd"] * state.abs()).to_event(1)


class Bimodal(Autoregression):
    """Only the state's square is seen: likelihood and posterior have two modes."""

    def emission(self, state, t):
        return Normal(state**2, 0.5).to_event(1)
