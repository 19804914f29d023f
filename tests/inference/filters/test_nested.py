"""The outer importance sampler."""

import math

import numpy as np
import oracles
import pytest
import torch

from invdyn.inference import Bootstrap, ParticleFilter, outer_weights


def test_weights_ess_and_evidence_by_hand():
    z = np.array([1.0, 2.0, 5.0])
    outer = outer_weights(torch.as_tensor(np.log(z) - 5000))
    w = z / z.sum()
    assert torch.exp(outer.log_weights).numpy() == pytest.approx(w)
    assert outer.ess == pytest.approx(1 / np.sum(w**2))
    assert outer.log_evidence == pytest.approx(np.log(z.mean()) - 5000)
    assert outer.log_evidence_sd == pytest.approx(z.std(ddof=1) / math.sqrt(3) / z.mean())
    assert outer.filter_sd == pytest.approx(np.log(z).std(ddof=1))


def test_equal_filters_are_all_worth_one():
    outer = outer_weights(torch.full((64,), 1234.5))
    assert outer.ess == pytest.approx(64)
    assert outer.log_evidence == pytest.approx(1234.5)
    assert outer.log_evidence_sd == pytest.approx(0, abs=1e-12)


def test_a_lucky_filter_carries_all():
    outer = outer_weights(torch.tensor([0.0, 0.0, 0.0, 200.0]))
    assert outer.ess == pytest.approx(1)
    assert outer.log_evidence == pytest.approx(200 - math.log(4))


def test_one_filter_has_no_scatter():
    outer = outer_weights(torch.tensor([3.0]))
    assert outer.log_evidence == pytest.approx(3.0)
    assert math.isnan(outer.filter_sd)
    assert math.isnan(outer.log_evidence_sd)


def test_the_stated_error_is_the_error():
    chain = oracles.random_chain(seed=5, noise=6.0)
    y = chain.simulate(10, seed=5)[1]
    model = chain.model(10)
    log_evidence = ParticleFilter(model, Bootstrap(model), 60, num_filters=3200).run(torch.as_tensor(y)).log_evidence
    outers = [outer_weights(group) for group in log_evidence.reshape(100, 32)]
    off = np.array([o.log_evidence for o in outers]) - oracles.kalman(chain, y)[0]
    stated = np.array([o.log_evidence_sd for o in outers])
    # 100 groups of 32: the rms of z is 1 with sd 0.07, and some for the estimated error
    assert np.sqrt(np.mean((off / stated) ** 2)) == pytest.approx(1, abs=0.35)
    assert np.mean(np.exp(off)) == pytest.approx(1, abs=4 * stated.mean() / 10)
