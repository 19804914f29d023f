"""Tempered SMC against quadrature, with exact and with estimated likelihoods; its exponents, and its seeds."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from parameter_answers import Quadrature, exact_log_likelihood, simulated
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import ess
from invdyn.inference.parameters.tempered import ParticleLikelihood, tempered, tempering_step
from invdyn.recordings import InputError


@pytest.fixture(scope="module")
def case():
    model, y = simulated("linear")
    return model, y, Quadrature(y)


def assert_posterior(result, exact, draws):
    """Means within 4 standard errors of so many independent draws, sds within 4 of theirs, evidence within 3 of its."""
    assert abs(result.log_evidence - exact.log_evidence[-1]) < 3 * result.log_evidence_sd
    assert result.log_evidence_sd < 0.25
    for name, mean in exact.mean.items():
        sd = exact.sd[name]
        assert abs(result.mean(name).item() - mean) < 4 * sd / math.sqrt(draws)
        assert abs(result.sd(name).item() / sd - 1) < 4 / math.sqrt(draws)


def test_posterior_and_evidence_are_those_of_quadrature(case):
    model, y, exact = case
    result = tempered(model, exact_log_likelihood(y), num_draws=1000, num_runs=8)
    # A waste-free chain of 20 steps is worth 2 or 3 draws.
    assert_posterior(result, exact, 8 * 1000 / 10)
    assert result.draws["noise_sd"].shape == (8, 1000, 1)
    assert torch.logsumexp(result.log_weights.flatten(), 0).item() == pytest.approx(0, abs=1e-9)


def test_an_unbiased_estimate_of_the_likelihood_has_the_same_answer(case):
    model, y, exact = case
    result = tempered(model, ParticleLikelihood(y, 30), num_draws=600, chain_length=12, num_runs=4)
    assert_posterior(result, exact, 4 * 600 / 20)


def test_the_standard_error_is_what_the_evidence_errs(case):
    model, y, exact = case
    z = []
    for seed in range(16):
        result = tempered(model, exact_log_likelihood(y), num_draws=100, chain_length=5, num_runs=6, seed=seed)
        z.append((result.log_evidence - exact.log_evidence[-1]) / result.log_evidence_sd)
    # Student-t of 5 degrees of freedom: the mean square of 16 lies in (.4, 6) with probability .99.
    assert 0.4 < np.square(z).mean() < 6


def test_the_same_seed_has_the_same_bits_with_workers_and_without(case):
    model, y, _ = case
    with ThreadPoolExecutor(2) as executor:
        one, two = (
            tempered(model, ParticleLikelihood(y[:5], 10), num_draws=20, chain_length=5, num_runs=3, executor=workers)
            for workers in (None, executor)
        )
    other = tempered(model, ParticleLikelihood(y[:5], 10), num_draws=20, chain_length=5, num_runs=3, seed=1)
    assert torch.equal(one.draws["process_sd"], two.draws["process_sd"])
    assert one.log_evidence == two.log_evidence != other.log_evidence


def test_exponents_leave_the_ess_that_was_set():
    torch.manual_seed(0)
    log_likelihood = torch.stack([50 * torch.randn(400), 0.01 * torch.randn(400)]).double()
    log_likelihood[0, :100] = -torch.inf
    start = torch.tensor([0.001, 0.3], dtype=torch.float64)
    exponent = tempering_step(log_likelihood, start, 200)
    left = ess((exponent - start).unsqueeze(-1) * log_likelihood)
    assert left[0].item() == pytest.approx(200, rel=1e-3)
    assert exponent[1] == 1

    # Fewer possible draws than that: next to the start, where they weigh the same.
    log_likelihood[0, :350] = -torch.inf
    exponent = tempering_step(log_likelihood, start, 200)
    assert start[0] < exponent[0] < start[0] + 1e-6


def test_what_cannot_be_run_is_refused(case):
    model, y, _ = case
    with pytest.raises(InputError, match=r"expected num_draws a multiple of chain_length, .* got 100, 30 and 4"):
        tempered(model, exact_log_likelihood(y), num_draws=100, chain_length=30)
    with pytest.raises(SMCFailed, match="none of 40 draws from the prior has a likelihood"):
        tempered(model, lambda batch: torch.full((len(batch.parameters["noise_sd"]),), -math.inf), num_draws=40)
