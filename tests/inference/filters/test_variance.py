"""The variance of a single run's estimates against that over 400 runs."""

import math

import numpy as np
import oracles
import pytest
import torch

from invdyn.inference import (
    Bootstrap,
    Controlled,
    ParticleFilter,
    gauss_newton,
    log_evidence_variance,
)

RUNS = 400


@pytest.fixture(scope="module")
def chain():
    """A slow state: rows' errors are correlated; its weights are even enough for the delta method."""
    one = np.eye(1)
    return oracles.Chain(0.8 * one, 0.36 * one, one, 2.0 * one, np.zeros(1), one)


def runs(chain, steps, particles, threshold, resampling="multinomial", count=RUNS):
    y = torch.as_tensor(oracles.with_gaps(chain.simulate(steps, seed=5)[1]))
    model = chain.model(steps)
    torch.manual_seed(0)
    filters = ParticleFilter(
        model, Bootstrap(model), particles, num_filters=count, ess_threshold=threshold, resampling=resampling
    )
    return filters.run(y)


def z(estimates, values):
    """How many standard errors the mean estimate is from the sample variance of ``values`` (400,)."""
    variance = values.var()
    error = math.hypot(float(variance) * math.sqrt(2 / len(values)) * 1.3, estimates.std() / math.sqrt(len(values)))
    return float((estimates.mean() - variance) / error)


@pytest.mark.quick("*-0.5", "*-1e-06")
@pytest.mark.parametrize("threshold", [1e-6, 0.5, 1.0])
@pytest.mark.parametrize("lag", [None, 6, 100])
def test_the_variance_of_the_log_evidence(chain, threshold, lag):
    result = runs(chain, 20, 300, threshold)
    assert bool(result.resampled.any()) == (threshold > 0.1)
    estimates = log_evidence_variance(result, lag=lag)
    assert estimates.shape == (RUNS,)
    # Var(log Ẑ) and Var(Ẑ/Z) agree to first order; both are small here.
    assert result.log_evidence.std() < 0.35
    assert abs(z(estimates, result.log_evidence)) < 4
    if threshold > 0.1:
        assert estimates.std() / estimates.mean() < 0.6
        # Of single rows it would be half.
        assert log_evidence_variance(result, lag=0).mean() < 0.75 * estimates.mean()


def test_without_resampling_it_is_the_sample_variance_of_the_weights(chain):
    result = runs(chain, 5, 50, 1e-6)
    weights = 50 * result.log_weights[-1].exp()
    assert torch.allclose(log_evidence_variance(result), weights.var(-1) / 50)


@pytest.mark.quick("*-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("resampling", ["systematic", "stratified", "residual"])
def test_other_schemes_of_resampling(chain, resampling, threshold):
    """Lee and Whiteley's unbiased form is negative here: it subtracts noise that these schemes do not have."""
    result = runs(chain, 20, 300, threshold, resampling)
    for lag in (None, 6):
        estimates = log_evidence_variance(result, lag=lag)
        assert abs(z(estimates, result.log_evidence)) < 4


def test_a_lag_outlasts_the_genealogy(chain):
    """After 120 rows all particles have one Eve or two, and late rows' errors are lost to those who look for her."""
    result = runs(chain, 120, 150, 1.0, count=200)
    variance = result.log_evidence.var()
    lagged = log_evidence_variance(result, lag=8)
    assert lagged.mean() / variance == pytest.approx(1, abs=0.35)
    assert log_evidence_variance(result).median() < 0.5 * variance


def test_a_twisted_filter_counts_its_twist(chain):
    """With the exact guide Ẑ has no variance; with one misled by other data it has, and it is estimated."""
    steps = 12
    model, y = chain.model(steps), torch.as_tensor(oracles.with_gaps(chain.simulate(steps, seed=5)[1]))
    exact = ParticleFilter(model, Controlled(model, y), 50, num_filters=3).run(y)
    assert log_evidence_variance(exact).abs().max() < 1e-10
    assert log_evidence_variance(exact, lag=2).abs().max() < 1e-10

    smoother = gauss_newton(model, y + 2.0 * torch.as_tensor(np.random.default_rng(0).normal(size=y.shape)))
    torch.manual_seed(1)
    misled = ParticleFilter(
        model, Controlled(model, y, smoother), 300, num_filters=RUNS, ess_threshold=0.9, resampling="multinomial"
    ).run(y)
    assert misled.resampled.any()
    assert misled.log_evidence.var() > 1e-4
    for lag in (None, 4):
        assert abs(z(log_evidence_variance(misled, lag=lag), misled.log_evidence)) < 4


@pytest.mark.parametrize(
    ("keep", "particles", "lag", "message"),
    [
        (5, 10, None, "kept all 12 rows, got 5"),
        (None, 1, None, "at least two particles"),
        (None, 10, -1, "lag of 0 rows or more"),
    ],
)
def test_what_it_cannot_do_is_refused(chain, keep, particles, lag, message):
    model, y = chain.model(12), torch.as_tensor(chain.simulate(12, seed=5)[1])
    result = ParticleFilter(model, Bootstrap(model), particles, num_filters=2).run(y, keep=keep)
    with pytest.raises(ValueError, match=message):
        log_evidence_variance(result, lag=lag)
