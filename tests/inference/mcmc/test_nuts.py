"""NUTS: its target, its diagnostics, and the plain Pyro sequence."""

import numpy as np
import pytest
import torch
from oracles import random_chain, rts
from pyro import poutine
from pyro.infer import MCMC, NUTS

from invdyn.inference import gauss_newton
from invdyn.inference.mcmc.mixing import mixing
from invdyn.inference.mcmc.nuts import whitened_model
from invdyn.inference.smoothing.gaussian_chain import GaussianChain


def test_the_whitened_target_is_the_models_own():
    chain = random_chain(2)
    _, y = chain.simulate(6, 0)
    model, y = chain.model(6), torch.as_tensor(y)
    y[2, 0] = torch.nan
    whitening = GaussianChain.of(gauss_newton(model, y))
    noise = torch.randn(4, 6, 3, dtype=torch.float64)
    target = whitened_model(model, y, whitening)
    values = torch.stack(
        [poutine.trace(poutine.condition(target, data={"noise": e})).get_trace().log_prob_sum() for e in noise]
    )
    off = values - model.log_joint(whitening.path(noise), y)
    assert (off - off[0]).numpy() == pytest.approx(0, abs=1e-8)  # rounding
    # and it is standard normal, as the model is linear and Gaussian
    flat = values + 0.5 * noise.square().sum((-2, -1))
    assert (flat - flat[0]).numpy() == pytest.approx(0, abs=1e-8)


def test_mixing_tells_good_chains_from_bad():
    rng = np.random.default_rng(0)
    good = rng.normal(size=(4, 200, 3))
    found = mixing(good)
    assert found["r_hat"] < 1.03
    assert 500 < found["ess_bulk"] < 1100
    apart = good.copy()
    apart[0, :, 1] += 3
    assert mixing(apart)["r_hat"] > 1.3
    slow = np.cumsum(0.1 * good, axis=1)
    assert mixing(slow)["ess_bulk"] < 50


@pytest.mark.slow
def test_nuts_takes_the_plain_sequence_as_it_is():
    """Unchanged: NUTS on model.sequence, whose moments are the Kalman smoother's."""
    chain = random_chain(4, dim=2, size=2)
    _, y = chain.simulate(3, 0)
    mean, covariance = rts(chain, y)
    torch.manual_seed(0)
    sampler = MCMC(NUTS(chain.model(3).sequence), num_samples=150, warmup_steps=60, disable_progbar=True)
    sampler.run(torch.as_tensor(y))
    draws = torch.stack([sampler.get_samples()[f"x_{t}"] for t in range(3)], 1).numpy()
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    # 150 draws worth 50 independent ones at least
    assert np.abs((draws.mean(0) - mean) / sd).max() < 3.5 / np.sqrt(50)
    assert np.abs(draws.std(0) / sd - 1).max() < 3.5 / np.sqrt(100)


@pytest.mark.parametrize(("chains", "draws", "known"), [(1, 3, 0), (3, 3, 0), (1, 8, 2), (2, 8, 3)])
def test_too_few_draws_tell_nothing_and_log_nothing(chains, draws, known, capfd):
    found = mixing(np.random.default_rng(0).normal(size=(chains, draws, 2)))
    assert np.isfinite([*found.values()]).sum() == known
    assert capfd.readouterr().err == ""
