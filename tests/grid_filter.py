"""Exact answers for models of one state: the filter's integrals as sums over a dense grid."""

import torch

from invdyn.models.observation.missing import observed_log_prob


@torch.no_grad()
def grid_evidence(model, observations, low, high, points=500):
    """Log-evidence, and the filtered means (T,), of a model with one state between ``low`` and ``high``."""
    x = torch.linspace(low, high, points, dtype=torch.float64).unsqueeze(-1)
    width, evidence, means = (high - low) / (points - 1), 0.0, []
    mass = model.initial().log_prob(x).exp() * width

    for t, y in enumerate(observations):
        if t > 0:
            mass = mass @ model.transition(x.unsqueeze(1), t).log_prob(x.unsqueeze(0)).exp() * width
        mass = mass * observed_log_prob(model.emission(x, t), y).exp()
        total = mass.sum()
        evidence, mass = evidence + total.log().item(), mass / total
        means.append((mass * x[:, 0]).sum())

    return evidence, torch.stack(means)
