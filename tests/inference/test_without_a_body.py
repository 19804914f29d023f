"""Filters, smoothing, variational SMC and particle Gibbs on a state-space model of a user's own that has no body.

    x_0 ~ N(0, 1),   x_t ~ N(x_{t−1} + 0.3 sin x_{t−1}, 0.4²),   y_t ~ N(x_t + 0.1 x_t², 0.5²)

One state, so that sums over a fine grid give the evidence and the smoothed means: an answer of another kind.
"""

import math

import numpy as np
import pyro
import pytest
import torch
from pyro.distributions import Normal
from pyro.infer import SVI
from pyro.optim import ClippedAdam
from scipy.stats import norm

from invdyn.inference import VSMC_ELBO, Corrected, SMCOptions, gaussian_smoother, run_chains, run_task, train
from invdyn.models import StateSpaceModel

T = 12


class Wave(StateSpaceModel):
    state_dim = observation_dim = 1
    num_steps = T

    def __init__(self):
        super().__init__({"noise": torch.tensor(0.4, dtype=torch.float64)})

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(state + 0.3 * state.sin(), self.parameters["noise"]).to_event(1)

    def emission(self, state, t):
        return Normal(state + 0.1 * state.square(), 0.5).to_event(1)


@pytest.fixture(scope="module")
def observed():
    """Observations (T, 1), one of them missing."""
    torch.manual_seed(4)
    y = Wave().simulate()[1]
    y[5] = torch.nan
    return y


@pytest.fixture(scope="module")
def exact(observed):
    """Log-evidence and smoothed means (T,), by forward and backward sums over a grid."""
    x = np.linspace(-8, 8, 2001)
    step, y = x[1] - x[0], observed[:, 0].numpy()
    kernel = norm.pdf(x, (x + 0.3 * np.sin(x))[:, None], 0.4) * step  # [before, after]
    seen = [np.ones_like(x) if np.isnan(v) else norm.pdf(v, x + 0.1 * x**2, 0.5) for v in y]
    forward, evidence = norm.pdf(x) * step * seen[0], 0.0
    filtered = []
    for t in range(T):
        if t:
            forward = forward @ kernel * seen[t]
        evidence += math.log(forward.sum())
        forward = forward / forward.sum()
        filtered.append(forward)
    backward, means = np.ones_like(x), np.empty(T)
    for t in reversed(range(T)):
        joint = filtered[t] * backward
        means[t] = joint @ x / joint.sum()
        backward = kernel @ (seen[t] * backward)
        backward = backward / backward.max()
    return evidence, means


def test_filters_and_backward_simulation(observed, exact):
    model, options = Wave(), SMCOptions(num_filters=64, num_particles=100, num_draws=10)
    smoother = gaussian_smoother(model, observed)
    for guide in ("controlled", "bootstrap"):
        found = run_task(model, observed, options, guide, smoother if guide == "controlled" else None, 3)
        log_evidence = (found["log_evidence"].logsumexp(0) - math.log(64)).item()
        error = found["log_evidence"].std().item() / 8
        assert error < 0.1
        assert log_evidence == pytest.approx(exact[0], abs=4 * error + 0.005)
        paths = found["paths"].double()[..., 0]
        # Draws of one filter share its particles: filters alone count as independent.
        weights = torch.softmax(found["log_evidence"], 0)
        assert (weights @ paths.mean(1)).numpy() == pytest.approx(exact[1], abs=0.12)


def test_variational_smc(observed, exact):
    model = Wave()
    guide = Corrected(model, observed, gaussian_smoother(model, observed))
    loss = VSMC_ELBO(num_particles=20, num_filters=8)
    with pyro.get_param_store().scope():
        torch.manual_seed(0)
        svi = SVI(model, guide, ClippedAdam({"lr": 0.01}), loss=loss)
        train(svi, 10, observed)
        bounds = -torch.tensor([svi.evaluate_loss(observed) for _ in range(10)])
    # A lower bound, and of a guide that begins near the best one a tight one.
    error = bounds.std().item() / math.sqrt(10)
    assert exact[0] - 0.2 < bounds.mean().item() < exact[0] + 4 * error


def test_particle_gibbs(observed, exact):
    model, options = Wave(), SMCOptions(num_filters=50, num_particles=10)
    smoother = gaussian_smoother(model, observed)
    for guide in (None, smoother):
        found = run_chains(model, observed, options, guide, 5, 10, 40)["paths"]  # (50, 30, T, 1)
        by_chain = found.mean(1)[..., 0]
        error = by_chain.std(0) / math.sqrt(50)
        assert ((by_chain.mean(0) - torch.as_tensor(exact[1])).abs() < 4.5 * error).all()
