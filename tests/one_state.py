"""State-space models of one state, whose evidence a grid gives (:mod:`grids`)."""

import math

import torch
from pyro.distributions import Bernoulli, Gamma, Normal, Poisson, StudentT, VonMises

from invdyn.models import StateSpaceModel


class Autoregression(StateSpaceModel):
    """x_t = 0.9 x_{t−1} + N(0, sd²), stationary; variants say what is seen of it."""

    state_dim = observation_dim = 1
    rho, sd = 0.9, 0.5

    def __init__(self, num_steps=20):
        super().__init__({"sd": torch.tensor(self.sd, dtype=torch.float64)})
        self.num_steps = num_steps

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), self.sd / math.sqrt(1 - self.rho**2)).to_event(1)

    def transition(self, state, t):
        return Normal(self.rho * state, self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.4).to_event(1)


class Volatility(Autoregression):
    """The standard deviation of what is seen is exp(x/2); its mean is zero."""

    rho, sd = 0.97, 0.3

    def emission(self, state, t):
        return Normal(torch.zeros_like(state), (state / 2).exp()).to_event(1)


class Counts(Autoregression):
    def emission(self, state, t):
        return Poisson((state + 0.5).exp()).to_event(1)


class Switches(Autoregression):
    def emission(self, state, t):
        return Bernoulli(logits=2 * state).to_event(1)


class Directions(Autoregression):
    def emission(self, state, t):
        return VonMises(state, torch.full_like(state, 4.0)).to_event(1)


class HeavyTailed(Autoregression):
    """Jumps now and then."""

    def transition(self, state, t):
        return StudentT(3.0, self.rho * state, 0.5 * self.parameters["sd"]).to_event(1)


class Positive(Autoregression):
    """Gamma transitions: no Gaussian approximation."""

    def initial(self):
        return Gamma(torch.full((1,), 4.0, dtype=self.dtype), 4.0).to_event(1)

    def transition(self, state, t):
        mean = 0.2 + 0.8 * state
        return Gamma(torch.full_like(mean, 8.0), 8 / mean).to_event(1)


class Multiplicative(Autoregression):
    """Noise that grows with the state."""

    def transition(self, state, t):
        return Normal(self.rho * state, 0.1 + self.parameters["sd"] * state.abs()).to_event(1)


class Growth(StateSpaceModel):
    """Gordon, Salmond & Smith (1993): the sign of the state is hardly seen."""

    state_dim = observation_dim = 1

    def __init__(self, num_steps=100):
        super().__init__({"sd": torch.tensor(math.sqrt(10.0), dtype=torch.float64)})
        self.num_steps = num_steps

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), math.sqrt(5.0)).to_event(1)

    def transition(self, state, t):
        t = torch.as_tensor(t, dtype=state.dtype)
        drive = 8 * torch.cos(1.2 * (t.unsqueeze(-1) if t.ndim else t))
        return Normal(state / 2 + 25 * state / (1 + state**2) + drive, self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(state**2 / 20, 1.0).to_event(1)
