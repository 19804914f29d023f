"""Smoothed trajectories against Rauch–Tung–Striebel, on linear models."""

import numpy as np
import oracles
import pytest
import torch

from invdyn.inference import (
    Bootstrap,
    Controlled,
    ParticleFilter,
    backward_simulation,
    gauss_newton,
    genealogy,
)
from invdyn.inference.filters.backward_simulation import check_density
from invdyn.inference.probe import ModelError

F32, F64 = torch.float32, torch.float64
STEPS = 16


def assert_draws_agree(draws, means, covs, effective, z=4.5):
    """Means and variances of draws (S, T, D), of which ``effective`` are worth an independent one."""
    draws = draws.double().flatten(0, -3).numpy()
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    assert np.abs((draws.mean(0) - means) / sd).max() < z / np.sqrt(effective)
    ratio = draws.var(0, ddof=1) / sd**2
    assert np.abs(ratio - 1).max() < z * np.sqrt(2 / effective)


def neighbours(draws):
    """Lag-one correlation matrix of draws (S, T, D) between rows t and t+1, averaged over rows."""
    draws = draws.double().flatten(0, -3).numpy()
    off = (draws - draws.mean(0)) / draws.std(0)
    return np.einsum("sti,stj->tij", off[:, :-1], off[:, 1:]) / len(off)


def exact_neighbours(chain, y):
    """The same, by RTS: Cov(x_t, x_{t+1} | y) = G_t P_{t+1}."""
    _, _, _, filtered = oracles.kalman(chain, y)
    _, covs = oracles.rts(chain, y)
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    out = []
    for t in range(len(y) - 1):
        predicted = chain.A @ filtered[t] @ chain.A.T + chain.Q
        gain = filtered[t] @ chain.A.T @ np.linalg.inv(predicted)
        out.append(gain @ covs[t + 1] / np.outer(sd[t], sd[t + 1]))
    return np.array(out)


@pytest.fixture(scope="module")
def chain():
    return oracles.random_chain(seed=5, noise=1.0)


@pytest.fixture(scope="module")
def y(chain):
    return oracles.with_gaps(chain.simulate(STEPS, seed=5)[1])


def controlled(chain, y, particles, filters, dtype=F64):
    model, y = chain.model(len(y), dtype), torch.as_tensor(y, dtype=dtype)
    smoother = gauss_newton(model, y)
    result = ParticleFilter(model, Controlled(model, y, smoother), particles, num_filters=filters).run(y)
    return model, y, smoother, result


@pytest.mark.parametrize("dtype", [F32, F64])
def test_genealogy_under_the_exact_guide(chain, y, dtype):
    # every particle is a draw from the smoothing distribution, and nothing is ever resampled
    _, _, _, result = controlled(chain, y, 50, 60, dtype)
    assert not result.resampled.any()
    draws = genealogy(result, 50)
    assert draws.shape == (60, 50, STEPS, 3)
    # fifty drawn with replacement from fifty: about half as good as independent ones
    assert_draws_agree(draws, *oracles.rts(chain, y), effective=1500)
    assert neighbours(draws) == pytest.approx(exact_neighbours(chain, y), abs=0.1)


@pytest.mark.quick("controlled-*")
@pytest.mark.parametrize(
    ("guide", "bridge", "block"),
    [
        ("controlled", False, 6),
        ("controlled", True, 1),
        ("controlled", True, 3),
        ("bootstrap", False, 6),
        ("bootstrap", True, 3),
    ],
)
def test_backward_simulation(chain, y, guide, bridge, block):
    model, observations, smoother, result = controlled(chain, y, 100, 100)
    if guide == "bootstrap":
        result = ParticleFilter(model, Bootstrap(model), 500, num_filters=60).run(observations)
        assert result.resampled.any()
    draws = backward_simulation(model, result, observations, 40, smoother=smoother if bridge else None, block=block)
    assert draws.shape == (len(result.log_evidence), 40, STEPS, 3)
    assert draws.dtype == F64
    assert_draws_agree(draws, *oracles.rts(chain, y), effective=600)
    assert neighbours(draws) == pytest.approx(exact_neighbours(chain, y), abs=0.1)


def test_backward_simulation_of_the_last_rows_only(chain, y):
    model, y = chain.model(STEPS), torch.as_tensor(y)
    smoother = gauss_newton(model, y)
    guide = Controlled(model, y, smoother)
    result = ParticleFilter(model, guide, 100, num_filters=60).run(y, keep=10)
    means, covs = oracles.rts(chain, y.numpy())
    for bridge in (None, smoother):
        draws = backward_simulation(model, result, y, 40, smoother=bridge, block=3)
        assert draws.shape == (60, 40, 10, 3)
        assert_draws_agree(draws, means[-10:], covs[-10:], effective=600)
    assert genealogy(result, 3).shape == (60, 3, 10, 3)


def stiff(q=1e-8):
    """Noise enters one coordinate and reaches the observed one two steps later, almost without noise."""
    A = np.array([[0.9, 0.0, 0.0], [0.1, 1.0, 0.0], [0.0, 0.1, 1.0]])
    Q = np.diag([0.2, q, q])
    return oracles.Chain(A, Q, np.array([[0.0, 0.0, 1.0]]), np.array([[0.01]]), np.zeros(3), np.eye(3))


def test_the_bridge_survives_dynamics_that_are_nearly_deterministic():
    steps, chain = 60, stiff()
    y = chain.simulate(steps, seed=1)[1]
    model, observations = chain.model(steps), torch.as_tensor(y)
    smoother = gauss_newton(model, observations)
    # a guide without foresight of its own, so that filters do resample
    torch.manual_seed(3)
    result = ParticleFilter(model, Bootstrap(model), 300, num_filters=8).run(observations)
    assert result.resampled.float().mean() > 0.2

    def distinct(draws, t):
        return np.mean([len(torch.unique(line[:, t, 0])) for line in draws])

    lines = genealogy(result, 50)
    plain = backward_simulation(model, result, observations, 50)
    bridged = backward_simulation(model, result, observations, 50, smoother=smoother)
    middle = steps // 3
    assert distinct(lines, middle) < 5
    assert distinct(plain, middle) < 10
    assert distinct(bridged, middle) > 40
    # and they are the right ones: scatter as wide as RTS says, and not far off it
    means, covs = oracles.rts(chain, y)
    sd = np.sqrt(covs[:, 0, 0])
    inner = slice(5, steps - 10)
    scatter = bridged[..., 0].std(1).mean(0).numpy() / sd
    assert 0.75 < scatter[inner].mean() < 1.25
    pooled = bridged[..., 0].flatten(0, 1).numpy()
    assert np.sqrt(np.mean(((pooled.mean(0) - means[:, 0]) / sd)[inner] ** 2)) < 0.6


@pytest.mark.long
def test_draws_are_weighted_by_the_last_rows_weights():
    one = np.ones((1, 1))
    chain = oracles.Chain(0.9 * one, one, one, 0.02 * one, np.zeros(1), one)
    y = chain.simulate(5, seed=0)[1]
    model = chain.model(5)
    result = ParticleFilter(model, Bootstrap(model), 2000, num_filters=20).run(torch.as_tensor(y))
    means, covs = oracles.rts(chain, y)
    for draws in (genealogy(result, 100), backward_simulation(model, result, torch.as_tensor(y), 100)):
        last = draws[..., -1, 0]
        assert last.mean().item() == pytest.approx(means[-1, 0], abs=5 * np.sqrt(covs[-1, 0, 0] / 1000))
        assert last.std().item() == pytest.approx(np.sqrt(covs[-1, 0, 0]), rel=0.1)


def test_states_that_a_simulation_runs_away_from_have_no_density():
    """A few of them: the draw goes through others. Where none has a density, the model is refused."""
    states = torch.zeros(1, 3, 2)
    reach = torch.tensor([[[0.0, torch.nan, -1.0]]])
    check_density(None, states, reach, 1)
    with pytest.raises(ModelError, match="expected a finite log-density in row 1"):
        check_density(None, states, torch.full_like(reach, torch.nan), 1)
    with pytest.raises(ModelError, match="expected a finite log-density in row 1"):
        check_density(None, states, torch.tensor([[[0.0, torch.inf, -1.0]]]), 1)
