"""Three state-space models with unknown parameters and their priors, on which samplers of parameters are compared.

    linear     x_0 ~ N(0, 1), x_t = .8 x_{t−1} + q ε,  y_t = x_t + r η;
               q, r log-normal, medians .5 and .5, sd .5
    volatility x_0 = μ + σ ε/√(1 − φ²), x_t = μ + φ (x_{t−1} − μ) + σ ε,  y_t = exp(x_t/2) η;
               μ ~ N(−1, .5²), φ ~ Beta(20, 2), σ log-normal, median .3, sd .4
    counts     x_0 ~ N(μ, 1), x_t = μ + .8 (x_{t−1} − μ) + σ ε,  y_t ~ Poisson(exp(x_t));
               μ ~ N(1, .5²), σ log-normal, median .4, sd .5

ε and η are standard normal; sds of log-normal parameters are those of their logarithms.
"""

import pyro.distributions as dist
import torch
from torch import Tensor

from invdyn.models.state_space import StateSpaceModel


def number(value: float) -> Tensor:
    return torch.tensor([value], dtype=torch.float64)


def log_normal(median: float, sd: float) -> dist.Distribution:
    return dist.LogNormal(number(median).log(), number(sd)).to_event(1)


class Linear(StateSpaceModel):
    """AR(1) seen with noise; its likelihood is the Kalman filter's."""

    state_dim = observation_dim = 1
    decay = 0.8

    def __init__(self, num_steps: int):
        super().__init__({"process_sd": number(0.5), "noise_sd": number(0.5)})
        self.num_steps = num_steps

    def initial(self) -> dist.Distribution:
        return dist.Normal(torch.zeros(1, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        return dist.Normal(self.decay * state, self.parameters["process_sd"]).to_event(1)

    def emission(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        return dist.Normal(state, self.parameters["noise_sd"]).to_event(1)


class Volatility(StateSpaceModel):
    """Log-variances that return to their mean: Taylor's stochastic volatility."""

    state_dim = observation_dim = 1

    def __init__(self, num_steps: int):
        super().__init__({"mean": number(-1.0), "persistence": number(0.9), "sd": number(0.3)})
        self.num_steps = num_steps

    def initial(self) -> dist.Distribution:
        p = self.parameters
        return dist.Normal(p["mean"], p["sd"] / (1 - p["persistence"] ** 2).sqrt()).to_event(1)

    def transition(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        p = self.parameters
        return dist.Normal(p["mean"] + p["persistence"] * (state - p["mean"]), p["sd"]).to_event(1)

    def emission(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        return dist.Normal(torch.zeros_like(state), (state / 2).exp()).to_event(1)


class Counts(StateSpaceModel):
    """Poisson counts whose log-rate is an AR(1)."""

    state_dim = observation_dim = 1

    def __init__(self, num_steps: int):
        super().__init__({"mean": number(1.0), "sd": number(0.4)})
        self.num_steps = num_steps

    def initial(self) -> dist.Distribution:
        return dist.Normal(self.parameters["mean"], number(1.0)).to_event(1)

    def transition(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        p = self.parameters
        return dist.Normal(p["mean"] + 0.8 * (state - p["mean"]), p["sd"]).to_event(1)

    def emission(self, state: Tensor, t: int | Tensor) -> dist.Distribution:
        return dist.Poisson(state.exp()).to_event(1)


MODELS = {
    "linear": lambda rows: Linear(rows).with_priors(process_sd=log_normal(0.5, 0.5), noise_sd=log_normal(0.5, 0.5)),
    "volatility": lambda rows: Volatility(rows).with_priors(
        mean=dist.Normal(number(-1.0), number(0.5)).to_event(1),
        persistence=dist.Beta(number(20.0), number(2.0)).to_event(1),
        sd=log_normal(0.3, 0.4),
    ),
    "counts": lambda rows: Counts(rows).with_priors(
        mean=dist.Normal(number(1.0), number(0.5)).to_event(1), sd=log_normal(0.4, 0.5)
    ),
}
