"""Rows of a Newton step: derivatives by hand, exact where log g is a quadratic, and what only they can see."""

import pytest
import torch
from grids import grid_posterior
from one_state import Counts, Directions, Switches, Volatility
from oracles import random_chain, with_gaps
from pyro.distributions import Normal

from invdyn.inference import gauss_newton, posterior_linearisation
from invdyn.inference.smoothing.newton_rows import REACH, averaged_newton_rows, keeps_noise, newton_rows
from invdyn.models import StateSpaceModel


class Two(StateSpaceModel):
    """Two states, of which the second scales the noise of what is seen of the first."""

    state_dim, observation_dim, num_steps = 2, 1, 3

    def initial(self):
        return Normal(torch.zeros(2, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(0.8 * state, 0.5).to_event(1)

    def emission(self, state, t):
        return Normal(state[..., :1], state[..., 1:].exp()).to_event(1)


def test_gradient_and_curvature_by_hand():
    model = Two({"unit": torch.ones((), dtype=torch.float64)})
    path = torch.tensor([[0.3, -0.2], [1.0, 0.4], [0.0, 0.0]], dtype=torch.float64)
    y = torch.tensor([[1.5], [-0.7], [torch.nan]], dtype=torch.float64)
    E, e, constant = newton_rows(model, path, y)

    r, s = y[:2, 0] - path[:2, 0], path[:2, 1].exp()
    gradient = torch.stack([r / s**2, r**2 / s**2 - 1], -1)
    torch.testing.assert_close((E.mT @ e.unsqueeze(-1))[:2, :, 0], gradient)
    precision = (
        torch.stack([torch.stack([r**0, 2 * r], -1), torch.stack([2 * r, 2 * r**2], -1)], -2) / s[:, None, None] ** 2
    )
    # That matrix is indefinite: its negative part is replaced by next to nothing, its positive part stays.
    values, vectors = torch.linalg.eigh(precision)
    found = torch.linalg.eigvalsh(E.mT @ E)[:2]
    torch.testing.assert_close(found[:, 1], values[:, 1])
    slope = (vectors.mT @ gradient.unsqueeze(-1))[:, 0, 0]
    torch.testing.assert_close(found[:, 0], (slope / REACH) ** 2, rtol=1e-6, atol=1e-12)
    torch.testing.assert_close(
        constant[:2] - 0.5 * e[:2].square().sum(-1), model.emission(path[:2], 0).log_prob(y[:2]), atol=1e-9, rtol=0
    )
    assert all((each[2] == 0).all() for each in (E, e, constant))


def test_a_quadratic_log_density_is_exact():
    chain = random_chain(seed=1)
    y = torch.as_tensor(with_gaps(chain.simulate(8)[1]))
    model = chain.model(8)
    plain = gauss_newton(model, y)
    path = plain.path
    emission = model.emission(path, torch.arange(8))
    assert keeps_noise(model, path, emission)
    E, e, constant = newton_rows(model, path, y)
    linear = plain.linearisation
    torch.testing.assert_close(E.mT @ E, torch.as_tensor(linear.E.swapaxes(-1, -2) @ linear.E), atol=1e-8, rtol=1e-8)
    torch.testing.assert_close(
        (E.mT @ e[..., None])[..., 0], torch.as_tensor((linear.E.swapaxes(-1, -2) @ linear.e[..., None])[..., 0])
    )
    root = 0.3 * torch.eye(model.state_dim, dtype=torch.float64).expand(8, -1, -1)
    wide = averaged_newton_rows(model, path, root, y)
    torch.testing.assert_close(wide[0].mT @ wide[0], E.mT @ E, atol=1e-7, rtol=1e-7)
    torch.testing.assert_close(wide[2] - 0.5 * wide[1].square().sum(-1), constant - 0.5 * e.square().sum(-1))


@pytest.mark.parametrize("kind", [Volatility, Counts, Switches, Directions])
def test_what_no_mean_sums_up_is_seen(kind):
    model = kind(30)
    torch.manual_seed(3)
    truth, y = model.simulate()
    exact = grid_posterior(model, y, -6, 6, 400).log_evidence
    mode = gauss_newton(model, y)
    around = posterior_linearisation(model, y, mode)
    assert bool(mode.converged)
    # A Laplace approximation of 30 rows; the prior's path, which is what a mean tells of volatility, is nats off.
    assert abs(float(mode.log_evidence) - exact) < 0.5
    assert abs(float(around.log_evidence) - exact) < 0.5
    assert (truth - mode.path).square().mean() < 0.7 * truth.square().mean()
    assert not torch.equal(mode.path, model.initial_paths(y)[0])
