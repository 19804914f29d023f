"""Exact answers for models of one real state, by sums over a dense grid."""

import math
from dataclasses import dataclass

import numpy as np
import pyro.distributions as dist
import torch

from invdyn.models import StateSpaceModel
from invdyn.models.observation.missing import observed_log_prob


@dataclass
class GridAnswer:
    """Log-evidence; smoothed means and variances (T,); filtered means (T,)."""

    log_evidence: float
    mean: np.ndarray
    variance: np.ndarray
    filtered: np.ndarray


def grid_answer(points, first, steps):
    """Of points (G,), p(x_0, y_0) (G,), and for each later row p(x_t, y_t | x_{t−1}) (G, G), x_{t−1} first."""
    width = points[1] - points[0]
    forward, totals, mass = [], [], first * width
    for t in range(len(steps) + 1):
        if t > 0:
            mass = forward[-1] @ steps[t - 1] * width
        totals.append(mass.sum())
        forward.append(mass / totals[-1])
    backward = [np.ones_like(points)]
    for step, total in zip(steps[::-1], totals[:0:-1], strict=True):
        backward.append(step @ backward[-1] * width / total)
    smoothed = np.array(forward) * np.array(backward[::-1])
    mean = smoothed @ points
    return GridAnswer(np.log(totals).sum(), mean, smoothed @ points**2 - mean**2, np.array(forward) @ points)


@torch.no_grad()
def grid_posterior(model, rows, low, high, points=500):
    """For a model of one state between ``low`` and ``high``, by its own densities, and rows (T, D)."""
    x = torch.linspace(low, high, points, dtype=torch.float64).unsqueeze(-1)
    seen = [observed_log_prob(model.emission(x, t), y) for t, y in enumerate(rows)]
    moved = [model.transition(x.unsqueeze(1), t).log_prob(x.unsqueeze(0)) for t in range(1, len(rows))]
    steps = [(move + of).exp().numpy() for move, of in zip(moved, seen[1:], strict=True)]
    return grid_answer(x[:, 0].numpy(), (model.initial().log_prob(x) + seen[0]).exp().numpy(), steps)


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
        steps.append(np.exp(step))
    return grid_answer(x, np.exp(log_normal(x, 0.0, 1.0) + log_normal(y[0], 0.0, np.exp(x / 2))), steps)
