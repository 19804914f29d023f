"""Gradients through resampling: transport against exact transport."""

import math

import oracles
import pyro
import pytest
import torch

from invdyn.inference import Bootstrap, Controlled
from invdyn.inference.filters.ot_resampling import transport
from invdyn.inference.variational.vsmc import VSMC_ELBO


def weighted(filters=3, size=40, dim=2, scatter=1.5, dtype=torch.float64, seed=0):
    torch.manual_seed(seed)
    x = 5.0 + torch.randn(filters, size, dim, dtype=dtype) * torch.tensor([1.0, 100.0], dtype=dtype)[:dim]
    return x, torch.log_softmax(scatter * torch.randn(filters, size, dtype=torch.float64), -1)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("iterations", [1, 50])
def test_the_weighted_mean_stays(dtype, iterations):
    x, log_weights = weighted(dtype=dtype)
    moved = transport(x, log_weights, iterations=iterations)
    assert moved.dtype == dtype
    assert moved.shape == x.shape
    mean = (log_weights.exp().unsqueeze(-1) * x).sum(-2)
    torch.testing.assert_close(moved.double().mean(-2), mean, rtol=1e-12 if dtype == torch.float64 else 1e-5, atol=1e-5)


def test_little_entropy_gives_exact_transport_in_one_dimension():
    """There, particle j becomes the mean of the weighted law between its quantiles j/N and (j + 1)/N."""
    x, log_weights = weighted(filters=1, size=8, dim=1)
    order = x[0, :, 0].argsort()
    x, log_weights = x[:, order], log_weights[:, order]
    edges = torch.cat([torch.zeros(1), log_weights[0].exp().cumsum(0)])
    strata = torch.arange(9, dtype=torch.float64) / 8
    overlap = torch.minimum(edges[1:, None], strata[None, 1:]) - torch.maximum(edges[:-1, None], strata[None, :-1])
    exact = 8 * overlap.clamp_min(0).mT @ x[0, :, 0]
    moved = transport(x, log_weights, regularisation=1e-3, iterations=4000)
    torch.testing.assert_close(moved[0, :, 0], exact, atol=2e-2, rtol=0)
    # much entropy: all particles at the mean
    assert transport(x, log_weights, regularisation=1e3).std() < 1e-2


def test_one_particle_with_all_the_weight_draws_all_to_itself():
    x, _ = weighted()
    log_weights = torch.full(x.shape[:2], -torch.inf, dtype=torch.float64)
    log_weights[:, 7] = 0.0
    moved = transport(x, log_weights)
    torch.testing.assert_close(moved, x[:, 7:8].expand_as(x))


def test_its_gradient_is_near_the_slope():
    x, log_weights = weighted(filters=1, size=12, scatter=0.7)
    direction = torch.randn_like(x)
    target = torch.randn_like(x)

    def value(x):
        return (transport(x, log_weights, 1.0, iterations=300) * target).sum()

    x.requires_grad_()
    (gradient,) = torch.autograd.grad(value(x), x)
    h = 1e-5
    slope = (value(x + h * direction) - value(x - h * direction)) / (2 * h)
    assert (gradient * direction).sum().item() == pytest.approx(slope.item(), rel=0.02)


@pytest.mark.parametrize(("regularisation", "iterations"), [(0.0, 10), (-1.0, 10), (math.nan, 10), (1.0, 0)])
def test_wrong_numbers_are_refused(regularisation, iterations):
    with pytest.raises(ValueError, match="expected a regularisation above zero"):
        transport(*weighted(), regularisation, iterations)


# -- in the bound ----------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def chain():
    chain = oracles.random_chain(seed=5, noise=6.0)
    y = oracles.with_gaps(chain.simulate(10, seed=5)[1])
    return chain.model(10), torch.as_tensor(y), oracles.kalman(chain, y)[0]


def test_transport_keeps_the_controlled_guides_exact_answer(chain):
    """What a guide carries along must be that of the moved particles, or its weights would not be constant."""
    model, y, exact = chain
    loss = VSMC_ELBO(20, 3, gradient="transport", ess_threshold=1.0)
    with torch.no_grad():
        found = loss.log_evidence(model.sequence, Controlled(model, y), y)
    assert found.tolist() == pytest.approx([exact] * 3, abs=1e-8)


def test_transport_comes_near_the_evidence(chain):
    model, y, exact = chain
    torch.manual_seed(1)
    with torch.no_grad():
        found = VSMC_ELBO(100, 20, gradient="transport", regularisation=0.1).log_evidence(
            model.sequence, Bootstrap(model), y
        )
    assert found.mean().item() == pytest.approx(exact, abs=0.5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_and_reach_the_model(chain, dtype):
    model, y, _ = chain
    pyro.clear_param_store()
    model, y = model.to(dtype).learn(["transition", "transition_root"]), y.to(dtype)
    torch.manual_seed(2)
    loss = VSMC_ELBO(30, 4, gradient="transport").differentiable_loss(model.sequence, Bootstrap(model), y)
    found = torch.autograd.grad(loss, [pyro.param(name).unconstrained() for name in ("transition", "transition_root")])
    for each in found:
        assert torch.isfinite(each).all()
        assert each.abs().max() > 1e-3


def test_wrong_settings_are_refused():
    with pytest.raises(ValueError, match="expected a regularisation"):
        VSMC_ELBO(10, 2, regularisation=0.0)
