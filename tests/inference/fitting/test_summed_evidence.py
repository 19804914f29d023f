"""Parameters that data sets share, against the Kalman filter's evidences added up by hand."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
import torch
from scipy.optimize import minimize

from invdyn.inference.fitting.log_parameters import Free, LogParameters
from invdyn.inference.fitting.objective import Objective
from invdyn.inference.fitting.summed_evidence import _Summed, at_common_start, fit_summed

FREE = [Free("transition_root", tied=True), Free("emission_root", tied=True, sd=0.7)]
LENGTHS = (20, 35, 27)


@pytest.fixture(scope="module")
def chain():
    return oracles.random_chain(seed=6)


@pytest.fixture(scope="module")
def sets(chain):
    return [oracles.with_gaps(chain.simulate(steps, seed=steps)[1]) for steps in LENGTHS]


def kalman(chain, y, phi):
    return oracles.kalman(replace(chain, Q=chain.Q * math.exp(2 * phi[0]), R=chain.R * math.exp(2 * phi[1])), y)[0]


def fitted(chain, sets):
    models = [chain.model(len(y)) for y in sets]
    return fit_summed(models, [torch.as_tensor(y) for y in sets], FREE, starts=[None] * len(sets))


def test_the_optimum_is_that_of_evidences_added_by_hand(chain, sets):
    def summed(phi):  # the prior once, whatever the number of data sets
        return 0.5 * ((phi[0] / 2.0) ** 2 + (phi[1] / 0.7) ** 2) - sum(kalman(chain, y, phi) for y in sets)

    best = minimize(summed, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8})
    found = fitted(chain, sets)
    sd = np.sqrt(np.diagonal(found.covariance))
    assert found.converged
    assert (np.abs(found.phi - best.x) < 0.2 * sd).all()
    assert found.log_evidence == pytest.approx([kalman(chain, y, found.phi) for y in sets], abs=1e-6)

    h = 1e-3 * np.eye(2)
    hessian = [
        [summed(best.x + a + b) - summed(best.x + a - b) - summed(best.x - a + b) + summed(best.x - a - b) for b in h]
        for a in h
    ]
    exact = np.linalg.inv(np.array(hessian) / 4e-6)
    assert found.covariance == pytest.approx(exact, abs=0.15 * exact.max())


TIGHT = [Free("transition_root", tied=True, sd=0.05), Free("emission_root", tied=True, sd=0.03)]
"""Priors that say as much as the data: one that is counted twice shows."""


def test_value_gradient_and_hessian_have_the_prior_once(chain, sets):
    """Away from the optimum, against differences of the Kalman filter's evidences."""
    models = [chain.model(len(y)) for y in sets]
    parts = [Objective(model, torch.as_tensor(y), TIGHT, None) for model, y in zip(models, sets, strict=True)]
    whole, at, h = _Summed(parts), np.array([0.08, -0.05]), 1e-3 * np.eye(2)

    def exact(phi):
        return 0.5 * ((phi[0] / 0.05) ** 2 + (phi[1] / 0.03) ** 2) - sum(kalman(chain, y, phi) for y in sets)

    gradient = [(exact(at + step) - exact(at - step)) / 2e-3 for step in h]
    hessian = [[exact(at + a + b) - exact(at + a - b) - exact(at - a + b) + exact(at - a - b) for b in h] for a in h]
    assert whole.value(at) - whole.value(0 * at) == pytest.approx(exact(at) - exact(0 * at), abs=1e-6)
    assert whole.gradient(at) == pytest.approx(gradient, rel=1e-3)
    assert whole.hessian(at) == pytest.approx(np.array(hessian) / 4e-6, rel=0.1, abs=20.0)


def test_a_prior_that_says_much_counts_once_in_the_covariance(chain, sets):
    models = [chain.model(len(y)) for y in sets]
    found = fit_summed(models, [torch.as_tensor(y) for y in sets], TIGHT, starts=[None] * 3)

    def summed(phi):
        return 0.5 * ((phi[0] / 0.05) ** 2 + (phi[1] / 0.03) ** 2) - sum(kalman(chain, y, phi) for y in sets)

    h = 1e-3 * np.eye(2)
    hessian = [
        [summed(found.phi + a + b) - summed(found.phi + a - b) - summed(found.phi - a + b) + summed(found.phi - a - b)
         for b in h] for a in h
    ]  # fmt: skip
    assert found.covariance == pytest.approx(np.linalg.inv(np.array(hessian) / 4e-6), rel=0.1, abs=3e-5)


def test_paths_stay_each_set_s_own(chain, sets):
    found = fitted(chain, sets)
    for y, path in zip(sets, found.paths, strict=True):
        scaled = replace(chain, Q=chain.Q * math.exp(2 * found.phi[0]), R=chain.R * math.exp(2 * found.phi[1]))
        assert path.numpy() == pytest.approx(oracles.rts(scaled, y)[0], abs=1e-6)


def test_models_of_other_starts_are_refused(chain, sets):
    models = [chain.model(len(y)) for y in sets]
    models[1] = models[1].replace(emission_root=2.0 * models[1].parameters["emission_root"])
    with pytest.raises(ValueError, match="at_common_start"):
        fit_summed(models, [torch.as_tensor(y) for y in sets], FREE, starts=[None] * len(sets))


def test_the_common_start_is_the_geometric_mean_and_phi_counts_from_it(chain):
    free = [Free("emission_root", tied=True)]
    model = chain.model(5)
    root = model.parameters["emission_root"]
    (first, second) = at_common_start([model, model.replace(emission_root=4.0 * root)], free)
    positive = root > 0
    assert first.parameters["emission_root"][positive].numpy() == pytest.approx(2 * root[positive].numpy())
    assert torch.equal(first.parameters["emission_root"], second.parameters["emission_root"])
    parameters = LogParameters(model, [Free("emission_root", entries=(0,))])
    assert parameters.of({"emission_root": 3.0 * root}) == pytest.approx([math.log(3.0)])
