"""Linear fits over a Gaussian, against quadrature and against what is exact."""

import math

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch

from invdyn.inference import gauss_newton, posterior_linearisation
from invdyn.inference.smoothing.posterior_linearisation import fit_linear, regress
from invdyn.models import StateSpaceModel

F64 = torch.float64


@pytest.mark.parametrize("iterations", [1, 3])
def test_linear_models_stay_exact(iterations):
    chain = oracles.random_chain(seed=1)
    y = oracles.with_gaps(chain.simulate(15, seed=1)[1])
    model, y = chain.model(15), torch.as_tensor(y)
    smoother = posterior_linearisation(model, y, gauss_newton(model, y), iterations)
    means, covs = oracles.rts(chain, y.numpy())
    assert smoother.path.numpy() == pytest.approx(means, abs=1e-7)
    assert smoother.covariance().numpy() == pytest.approx(covs, abs=1e-7)
    assert smoother.log_evidence.item() == pytest.approx(oracles.kalman(chain, y.numpy())[0], abs=1e-7)


def test_the_regression_is_that_of_the_moments():
    """Mean, slope and left-over covariance of a quadratic function; the cubature is exact to degree 3."""
    rng = np.random.default_rng(0)
    root = torch.as_tensor(np.tril(rng.normal(size=(2, 2))))
    centre = torch.as_tensor(rng.normal(size=2))
    curve = torch.as_tensor(rng.normal(size=(3, 2, 2)))
    linear = torch.as_tensor(rng.normal(size=(3, 2)))

    def function(x):
        return x @ linear.mT + torch.einsum("pij,...i,...j->...p", curve, x, x)

    value, slope, error = regress(function, centre, root)
    cov = root @ root.mT
    both = curve + curve.mT
    expected = function(centre) + torch.einsum("pij,ij->p", curve, cov)
    torch.testing.assert_close(value, expected)
    torch.testing.assert_close(slope, linear + torch.einsum("pij,j->pi", both, centre))
    # what is left over is no less than zero, and none for a linear function
    assert torch.linalg.eigvalsh(error @ error.mT).min() > -1e-12
    _, flat, none = regress(lambda x: x @ linear.mT, centre, root)
    torch.testing.assert_close(flat, linear)
    assert none.abs().max() < 1e-12


class Squared(StateSpaceModel):
    """One wide coordinate seen through a bend: tangents mislead here."""

    state_dim = observation_dim = num_steps = 1

    def __init__(self):
        super().__init__({"sd": torch.ones(1, dtype=F64)})

    def initial(self):
        return dist.Normal(torch.full((1,), 1.0, dtype=F64), self.parameters["sd"]).to_event(1)

    def transition(self, state, t):
        return dist.Normal(state + 0.4 * torch.sin(2 * state), 0.3 * self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return dist.Normal(state + 0.3 * state**2, 0.8).to_event(1)


def two_rows():
    model = Squared()
    model.num_steps = 2
    return model


def by_quadrature(model, y):
    """Log-evidence, mean and sd of x_0 and x_1."""
    grid = torch.linspace(-6, 7, 1500, dtype=F64).unsqueeze(-1)
    first = model.initial().log_prob(grid) + model.emission(grid, 0).log_prob(y[0])
    last = model.emission(grid, 1).log_prob(y[1])
    move = torch.stack([model.transition(x, 1).log_prob(grid) for x in grid])
    joint = first[:, None] + move + last[None, :] + 2 * math.log(grid[1] - grid[0])
    evidence = joint.logsumexp((0, 1))
    weight = torch.exp(joint - evidence)
    x = grid.squeeze(-1)
    means = [(weight.sum(1) * x).sum(), (weight.sum(0) * x).sum()]
    sds = [((weight.sum(1 - i) * (x - means[i]) ** 2).sum()).sqrt() for i in range(2)]
    return evidence.item(), np.array(means), np.array(sds)


@pytest.mark.parametrize("value", [-0.5, 0.5, 2.0])
def test_it_improves_on_the_tangent_where_the_posterior_is_wide(value):
    model = two_rows()
    y = torch.tensor([[value], [value + 0.5]], dtype=F64)
    evidence, means, _ = by_quadrature(model, y)
    mode = gauss_newton(model, y)
    fitted = posterior_linearisation(model, y, mode, 3)
    assert abs(fitted.log_evidence.item() - evidence) < 0.2
    off = np.abs(fitted.path.squeeze(-1).numpy() - means).max()
    assert off < 0.2
    assert off < np.abs(mode.path.squeeze(-1).numpy() - means).max() + 0.02


def test_the_emissions_error_is_added_to_its_noise():
    model = two_rows()
    y = torch.tensor([[1.0], [torch.nan]], dtype=F64)
    path = torch.tensor([[1.0], [0.5]], dtype=F64)
    wide = torch.full((2, 1, 1), 0.49, dtype=F64)
    linear = fit_linear(model, y, path, wide)
    # x + 0.3 x² at x ± 0.7: mean 1.3 + 0.147; the two cubature points of one dimension fit a line exactly
    slope = 1 + 0.6
    assert linear.E[0, 0, 0] == pytest.approx(slope / 0.8, rel=1e-6)
    assert linear.e[0, 0] == pytest.approx((1.0 - 1.447) / 0.8, rel=1e-6)
    assert np.all(linear.E[1] == 0)
    assert np.all(linear.e[1] == 0)


def test_two_dimensions_leave_an_error():
    """Of x₀² over a Gaussian in two dimensions, a sum of squares that inflates the noise."""

    class Plane(Squared):
        state_dim, observation_dim = 2, 1

        def initial(self):
            return dist.Normal(torch.zeros(2, dtype=F64), torch.ones(2, dtype=F64)).to_event(1)

        def transition(self, state, t):
            return dist.Normal(state, torch.ones(2, dtype=F64)).to_event(1)

        def emission(self, state, t):
            return dist.Normal(state[..., :1] ** 2, 0.8).to_event(1)

    model = Plane()
    model.num_steps = 2
    y = torch.tensor([[1.0], [1.0]], dtype=F64)
    variance = 0.5
    linear = fit_linear(model, y, torch.zeros(2, 2, dtype=F64), variance * torch.eye(2, dtype=F64).expand(2, 2, 2))
    # points ±√(2·0.5) along each axis: values 1, 1, 0, 0 → mean ½, error variance ¼, slope 0
    assert np.abs(linear.E).max() < 1e-6
    noise = math.sqrt(0.8**2 + 0.25)
    assert linear.e == pytest.approx(np.full((2, 1), 0.5 / noise), rel=1e-6)
    constant = -2 * (math.log(noise) + 0.5 * math.log(2 * math.pi))
    assert linear.log_constant.item() == pytest.approx(constant, rel=1e-6)
