"""Parameters by Laplace's evidence: exact on linear models."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
import torch
from pages import script
from scipy.optimize import minimize

from invdyn.inference.fitting.log_parameters import Free

SCRIPT = script("benchmarks/laplace_evidence.py")
CURVATURE_STEP, fit_at_mode = SCRIPT.CURVATURE_STEP, SCRIPT.fit_at_mode
FREE = [Free("transition_root", tied=True), Free("emission_root", tied=True, sd=0.7)]
STEPS = 60


def exact(chain, y):
    """Negative log-posterior of φ, by the Kalman filter: factors of e^φ on the roots, e^2φ on the covariances."""

    def value(phi):
        scaled = replace(chain, Q=chain.Q * math.exp(2 * phi[0]), R=chain.R * math.exp(2 * phi[1]))
        return -oracles.kalman(scaled, y)[0] + 0.5 * ((phi[0] / 2.0) ** 2 + (phi[1] / 0.7) ** 2)

    return value


def test_of_linear_models_it_is_the_kalman_filters():
    chain = oracles.random_chain(seed=6)
    y = oracles.with_gaps(chain.simulate(STEPS, seed=6)[1])
    value = exact(chain, y)
    best = minimize(value, np.zeros(2))
    found = fit_at_mode(chain.model(STEPS), torch.as_tensor(y), FREE)
    sd = np.sqrt(np.diagonal(found.covariance))
    assert found.converged
    assert np.abs(found.phi - best.x).max() < 0.35 * sd.min()  # .06 nats
    prior = 0.5 * ((found.phi / [2.0, 0.7]) ** 2).sum()
    assert found.log_evidence == pytest.approx(-value(found.phi) + prior, abs=1e-6)
    h = CURVATURE_STEP
    curved = [value(found.phi + h * e) + value(found.phi - h * e) - 2 * value(found.phi) for e in np.eye(2)]
    precision = np.diagonal(np.linalg.inv(found.covariance))
    np.testing.assert_allclose(precision, np.array(curved) / h**2, rtol=1e-6)
    np.testing.assert_allclose(found.log_sd["transition_root"], sd[0])


def test_what_it_cannot_fit_is_reported():
    chain = oracles.random_chain(seed=6)
    y = torch.as_tensor(chain.simulate(STEPS, seed=6)[1])
    with pytest.raises(ValueError, match="expected parameters to fit, got none"):
        fit_at_mode(chain.model(STEPS), y, [])
    with pytest.raises(KeyError, match="noise"):
        fit_at_mode(chain.model(STEPS), y, [Free("noise")])
