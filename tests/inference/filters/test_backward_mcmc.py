"""Backward sampling by MCMC against the genealogy, exact backward simulation and Rauch–Tung–Striebel."""

import numpy as np
import oracles
import pytest
import torch

from invdyn.inference import (
    Bootstrap,
    Controlled,
    ParticleFilter,
    backward_mcmc,
    backward_simulation,
    gauss_newton,
    genealogy,
)
from invdyn.models import LinearGaussian

T = 40


@pytest.fixture(scope="module")
def chain():
    return oracles.noisy_chain()


@pytest.fixture(scope="module")
def y(chain):
    return oracles.with_gaps(chain.simulate(T, seed=5)[1])


def filtered(chain, y, particles, filters, threshold=0.5, guide="bootstrap"):
    model, rows = chain.model(T), torch.as_tensor(y)
    proposal = Bootstrap(model)
    if guide == "controlled":
        # Linearised at other data: its twist must be taken off, or the draws follow those.
        proposal = Controlled(model, rows, gauss_newton(model, 0.7 * rows))
    torch.manual_seed(0)
    result = ParticleFilter(model, proposal, particles, num_filters=filters, ess_threshold=threshold).run(rows)
    assert result.resampled.any()
    return model, rows, result


def errors(draws, chain, y):
    """Means' errors in posterior sds (T, D), and the draws' variances over the exact ones (T, D)."""
    means, covs = oracles.rts(chain, y)
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    draws = draws.flatten(0, 1).numpy()
    return np.abs(draws.mean(0) - means) / sd, draws.var(0) / sd**2


@pytest.mark.quick("*-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("guide", ["bootstrap", "controlled"])
def test_it_agrees_with_rts(chain, y, guide, threshold):
    model, rows, result = filtered(chain, y, 500, 60, threshold, guide)
    draws = backward_mcmc(model, result, rows, 40, seed=1, steps=2)
    assert draws.shape == (60, 40, T, 2)
    assert draws.dtype == torch.float64
    off, ratio = errors(draws, chain, y)
    assert off.max() < 4.5 / np.sqrt(600)
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / 600)


def test_a_step_or_two_part_lines_that_the_genealogy_joins(chain, y):
    model, rows, result = filtered(chain, y, 200, 20, threshold=1.0)

    def distinct(draws):
        return np.mean([len(torch.unique(line[:, 2, 0])) for line in draws])

    counts = [distinct(backward_mcmc(model, result, rows, 50, seed=1, steps=steps)) for steps in (0, 1, 3)]
    assert abs(counts[0] - distinct(genealogy(result, 50))) < 1
    assert 2 * counts[0] < counts[1] < counts[2]
    assert counts[2] > 0.6 * distinct(backward_simulation(model, result, rows, 50))


def test_without_a_step_it_is_the_genealogy(chain, y):
    model, rows, result = filtered(chain, y, 50, 3)
    torch.manual_seed(9)
    lines = genealogy(result, 20)
    assert torch.equal(backward_mcmc(model, result, rows, 20, seed=9, steps=0), lines)


@pytest.mark.long
def test_many_steps_forget_where_they_began(chain, y):
    """From a wrong start, the kernel still comes to the backward distribution."""
    model, rows, result = filtered(chain, y, 100, 60)
    misplaced = result.ancestors.clone()
    misplaced[1:] = 0
    result.ancestors = misplaced
    off, ratio = errors(backward_mcmc(model, result, rows, 40, seed=2, steps=60), chain, y)
    assert off.max() < 4.5 / np.sqrt(300)
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / 300)


def test_a_state_without_noise_keeps_the_genealogy():
    """AR(2) as a pair: a density exists for no other parent, and the draws are still right."""

    class Pair(LinearGaussian):
        def transition(self, state, t):
            mean = torch.stack([1.2 * state[..., 0] - 0.5 * state[..., 1], state[..., 0]], -1)
            scale = torch.tensor([0.6, 0.0], dtype=torch.float64)
            return torch.distributions.Independent(torch.distributions.Normal(mean, scale, validate_args=False), 1)

    eye = np.eye(2)
    A, C = np.array([[1.2, -0.5], [1.0, 0.0]]), np.array([[1.0, 0.0]])
    chain = oracles.Chain(A, np.diag([0.36, 1e-12]), C, 0.5 * np.eye(1), np.zeros(2), eye)
    y = chain.simulate(20, seed=2)[1]
    numbers = (A, eye, C, chain.R, chain.m, chain.P)
    model, rows = Pair(*map(torch.as_tensor, numbers), 20), torch.as_tensor(y)
    torch.manual_seed(0)
    result = ParticleFilter(model, Bootstrap(model), 1000, num_filters=150).run(rows)
    draws = backward_mcmc(model, result, rows, 10, seed=0)
    assert torch.equal(draws[..., 1:, 1], draws[..., :-1, 0])
    off, ratio = errors(draws, chain, y)
    assert off.max() < 4.5 / np.sqrt(150)
    assert np.abs(ratio - 1).max() < 4.5 * np.sqrt(2 / 150)


def test_the_last_rows_only(chain, y):
    model, rows = chain.model(T), torch.as_tensor(y)
    result = ParticleFilter(model, Bootstrap(model), 500, num_filters=60).run(rows, keep=10)
    draws = backward_mcmc(model, result, rows, 40, seed=1)
    means, covs = oracles.rts(chain, y)
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    assert np.abs((draws.flatten(0, 1).mean(0).numpy() - means[-10:]) / sd[-10:]).max() < 4.5 / np.sqrt(600)


def test_same_seed_same_draws_and_bad_sizes(chain, y):
    model, rows, result = filtered(chain, y, 20, 2)
    first = backward_mcmc(model, result, rows, 5, seed=3)
    torch.manual_seed(77)
    assert torch.equal(first, backward_mcmc(model, result, rows, 5, seed=3))
    for num_draws, steps in ((0, 1), (1, -1)):
        with pytest.raises(ValueError, match="expected at least one draw"):
            backward_mcmc(model, result, rows, num_draws, seed=0, steps=steps)
