"""Exact posteriors of the linear model of benchmarks/parameter_models.py, by Kalman filters on a grid of parameters."""

import numpy as np
import torch
from pages import script

from invdyn.inference.execution.seeds import seeded

MODELS = script("benchmarks/parameter_models.py").MODELS
CENTRE, SD = np.log(0.5), 0.5
"""Prior of both log-parameters of the linear model."""


def kalman_log_likelihood(process_sd, noise_sd, y, decay=0.8):
    """Increments (T, ...) of log p(y | q, r), and smoothed means (T, ...), of parameters of shape (...), y (T,)."""
    mean, variance = np.zeros_like(process_sd), np.ones_like(process_sd)
    increments, filtered, predicted = [], [], []
    for t, seen in enumerate(y):
        if t > 0:
            mean, variance = decay * mean, decay**2 * variance + process_sd**2
        predicted.append((mean, variance))
        total = variance + noise_sd**2
        increments.append(-0.5 * (np.log(2 * np.pi * total) + (seen - mean) ** 2 / total))
        gain = variance / total
        mean, variance = mean + gain * (seen - mean), (1 - gain) * variance
        filtered.append((mean, variance))
    smoothed = [mean]
    for (mean, variance), (ahead, ahead_variance) in zip(filtered[-2::-1], predicted[:0:-1], strict=True):
        smoothed.append(mean + decay * variance / ahead_variance * (smoothed[-1] - ahead))
    return np.array(increments), np.array(smoothed[::-1])


def exact_log_likelihood(y):
    """Log p(y | θ) (M,) of the linear model with M parameter sets."""

    def of(model):
        q, r = (model.parameters[name].flatten().numpy() for name in ("process_sd", "noise_sd"))
        return torch.as_tensor(kalman_log_likelihood(q, r, y.flatten().numpy())[0].sum(0))

    return of


class Quadrature:
    """Posterior of the linear model given y (T, 1), by 201 × 201 points over five prior sds on each side.

    Attributes:
        log_evidence: (T,) log p(y_{0:t}) of the first rows.
        mean, sd: of each parameter.
        states: (T,) posterior means of the states.
    """

    def __init__(self, y):
        axis = CENTRE + SD * np.linspace(-5, 5, 201)
        log_q, log_r = np.meshgrid(axis, axis, indexing="ij")
        increments, smoothed = kalman_log_likelihood(np.exp(log_q), np.exp(log_r), y.flatten().numpy())
        prior = -0.5 * (((log_q - CENTRE) / SD) ** 2 + ((log_r - CENTRE) / SD) ** 2)
        prior -= np.log(np.exp(prior).sum())
        joint = prior + increments.cumsum(0)
        top = joint.max((1, 2), keepdims=True)
        self.log_evidence = np.log(np.exp(joint - top).sum((1, 2))) + top[:, 0, 0]
        posterior = np.exp(joint[-1] - self.log_evidence[-1])
        values = {"process_sd": np.exp(log_q), "noise_sd": np.exp(log_r)}
        self.mean = {name: (posterior * value).sum() for name, value in values.items()}
        self.sd = {name: np.sqrt((posterior * (value - self.mean[name]) ** 2).sum()) for name, value in values.items()}
        self.states = (posterior * smoothed).sum((1, 2))


def simulated(name, rows=15, seed=3):
    """A model with priors, and observations (T, O) of it at its own parameters."""
    model = MODELS[name](rows)
    with seeded(seed):
        return model, model.simulate()[1]
