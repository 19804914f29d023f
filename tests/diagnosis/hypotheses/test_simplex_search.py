"""A search without slopes, where the integral is known."""

from itertools import product

import numpy as np
import pytest
import torch
from pyro.distributions import LogNormal

from invdyn.diagnosis.hypotheses.simplex_search import climb, grid, log_density_of, log_sd_prior
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects.base import Parameter


class Two:
    """An effect of two parameters, one of which has a grid of its own."""

    def parameters(self, scale):
        return Parameter("width", "m", LogNormal(-3.0, 0.5)), Parameter(
            "period", "1", LogNormal(0.0, 1.0), grid=(1.0, 2.0)
        )


@pytest.mark.parametrize("p", [1, 2, 3])
def test_a_gaussian_is_integrated(p):
    generator = np.random.default_rng(p)
    root = np.eye(p) + 0.3 * generator.standard_normal((p, p))
    covariance, mode, top = 0.2 * root @ root.T, generator.standard_normal(p), 7.0
    precision = np.linalg.inv(covariance)

    def score(x):
        return top - 0.5 * (x - mode) @ precision @ (x - mode)

    found, spread, integral = climb(score, mode + 0.3)
    assert top - score(found) < 0.2  # the simplex stops within a tenth of a nat, or when its evaluations are over
    np.testing.assert_allclose(spread, covariance, rtol=1e-6, atol=1e-9)
    exact = score(found) + 0.5 * (p * np.log(2 * np.pi) + np.linalg.slogdet(covariance)[1])
    assert integral == pytest.approx(exact, abs=1e-6)


def test_where_nothing_curves_the_spread_is_one():
    _, spread, integral = climb(lambda x: 0.0, np.zeros(2))
    np.testing.assert_allclose(spread, np.eye(2), atol=1e-12)
    assert integral == pytest.approx(np.log(2 * np.pi))


def test_a_grid_is_of_the_priors_quantiles_or_a_parameters_own():
    (width, period), points = grid(Two(), None)
    assert (width.name, period.name) == ("width", "period")
    assert points == list(product(sorted({point[0] for point in points}), (1.0, 2.0)))
    below = width.prior.cdf(torch.tensor([point[0] for point in points[::2]])).numpy()
    np.testing.assert_allclose(below, DEFAULT.descent.prior_quantiles, atol=4 * 0.5 / np.sqrt(2000))
    assert log_sd_prior(width) == pytest.approx(0.5, rel=0.1)


def test_the_prior_is_of_logarithms():
    parameters = [*Two().parameters(None)]
    values = np.array([0.06, 1.5])
    normal = [
        torch.distributions.Normal(m, s).log_prob(torch.tensor(np.log(v))) for m, s, v in ((-3, 0.5, 0.06), (0, 1, 1.5))
    ]
    assert log_density_of(parameters, values) == pytest.approx(float(sum(normal)), abs=1e-5)
