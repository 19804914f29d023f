"""Exact answers for models with one real state, by sums over a dense grid; densities in plain numpy."""

import math
from dataclasses import dataclass

import numpy as np
import pyro.distributions as dist
import torch

from invdyn.models import StateSpaceModel


@dataclass
class GridAnswer:
    """Log-evidence; smoothed means and variances (T,); filtered means (T,)."""

    log_evidence: float
    mean: np.ndarray
    variance: np.ndarray
    filtered: np.ndarray


def grid_answer(points, first, steps):
    """Of points (G,), log p(x_0, y_0) (G,), and for each later row log p(x_t, y_t | x_{t−1}) (G, G), x_{t−1} first."""
    log_width = math.log(points[1] - points[0])
    forward, totals = [first + log_width], []
    for t in range(len(steps) + 1):
        joint = forward[t]
        totals.append(np.logaddexp.reduce(joint))
        forward[t] = joint - totals[-1]
        if t < len(steps):
            forward.append(np.logaddexp.reduce(forward[t][:, None] + steps[t], axis=0) + log_width)
    backward = [np.zeros_like(points)]
    for step, total in zip(steps[::-1], totals[:0:-1], strict=True):
        backward.append(np.logaddexp.reduce(step + backward[-1], axis=1) + log_width - total)
    smoothed = np.exp(np.array(forward) + np.array(backward[::-1]))
    mean = smoothed @ points
    return GridAnswer(sum(totals), mean, smoothed @ points**2 - mean**2, np.exp(forward) @ points)


def log_normal(value, mean, sd):
    """Log N(value; mean, sd²)."""
    return -0.5 * ((value - mean) / sd) ** 2 - np.log(sd) - 0.5 * math.log(2 * math.pi)


class Leverage(StateSpaceModel):
    """Stochastic volatility in which a fall of the price raises it (Jacquier, Polson & Rossi 2004).

    x_t = φ x_{t−1} + σ η_t and y_t = exp(x_t / 2) ε_t with Corr(ε_t, η_t) = ρ.
    """

    state_dim = observation_dim = 1

    def __init__(self, steps, phi=0.9, sigma=0.5, rho=-0.8):
        numbers = {"phi": phi, "sigma": sigma, "rho": rho}
        super().__init__({name: torch.tensor(value, dtype=torch.float64) for name, value in numbers.items()})
        self.num_steps = steps

    def initial(self):
        return dist.Normal(torch.zeros(1, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        return dist.Normal(self.parameters["phi"] * state, self.parameters["sigma"]).to_event(1)

    def emission(self, state, t):
        return dist.Normal(torch.zeros_like(state), (state / 2).exp()).to_event(1)

    def emission_given(self, previous, state, t):
        phi, sigma, rho = (self.parameters[name] for name in ("phi", "sigma", "rho"))
        noise = (state - phi * previous) / sigma
        scale = (state / 2).exp()
        return dist.Normal(rho * scale * noise, scale * (1 - rho**2).sqrt()).to_event(1)


def leverage_answer(y, phi=0.9, sigma=0.5, rho=-0.8, size=600):
    """For :class:`Leverage` and y (T,)."""
    x = np.linspace(-7, 7, size)
    steps = []
    for value in y[1:]:
        noise = (x[None] - phi * x[:, None]) / sigma
        step = log_normal(x[None], phi * x[:, None], sigma)
        if np.isfinite(value):
            scale = np.exp(x / 2)[None]
            step = step + log_normal(value, rho * scale * noise, scale * math.sqrt(1 - rho**2))
        steps.append(step)
    return grid_answer(x, log_normal(x, 0.0, 1.0) + log_normal(y[0], 0.0, np.exp(x / 2)), steps)


class Growth(StateSpaceModel):
    """x_t = x/2 + 25 x/(1 + x²) + 8 cos(1.2 t) + N(0, 10), y_t = x²/20 + N(0, 1) (Gordon, Salmond & Smith 1993)."""

    state_dim = observation_dim = 1

    def __init__(self, steps):
        super().__init__({"noise": torch.tensor(math.sqrt(10.0), dtype=torch.float64)})
        self.num_steps = steps

    def initial(self):
        return dist.Normal(torch.zeros(1, dtype=torch.float64), 2.0).to_event(1)

    def transition(self, state, t):
        push = 8 * torch.cos(1.2 * torch.as_tensor(t, dtype=torch.float64))
        push = push.unsqueeze(-1) if push.ndim else push
        return dist.Normal(state / 2 + 25 * state / (1 + state**2) + push, self.parameters["noise"]).to_event(1)

    def emission(self, state, t):
        return dist.Normal(state**2 / 20, 1.0).to_event(1)


def growth_answer(y, size=900):
    """For :class:`Growth` and y (T,)."""
    x = np.linspace(-45, 45, size)
    steps = []
    for t, value in enumerate(y[1:], 1):
        mean = x / 2 + 25 * x / (1 + x**2) + 8 * math.cos(1.2 * t)
        step = log_normal(x[None], mean[:, None], math.sqrt(10.0))
        steps.append(step + (log_normal(value, x**2 / 20, 1.0)[None] if np.isfinite(value) else 0.0))
    return grid_answer(x, log_normal(x, 0.0, 2.0) + log_normal(y[0], x**2 / 20, 1.0), steps)
