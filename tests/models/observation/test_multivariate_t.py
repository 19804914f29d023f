"""Detections with heavy tails: densities against scipy's, the bound of reweighted least squares, drawing."""

import numpy as np
import pytest
import torch
from scipy.stats import kstest, multivariate_t, norm, t

from invdyn.models import Encoders, Keypoints, Link, Observation, planar_body
from invdyn.models.observation.missing import gaussian_rows, observed_log_prob
from invdyn.models.observation.multivariate_t import MultivariateT

F64 = torch.float64
LOC = np.array([0.1, 0.2, 0.5, -0.1, 1.2])  # two points and an encoder
SCALE = np.array([0.02, 0.03, 0.03, 0.04, 0.01])
DEGREES = 4.0
ROWS = {
    "near": LOC + 0.01,
    "far": LOC + np.array([0.0, 0.0, 0.6, -0.4, 0.0]),
    "half missing": np.where(np.arange(5) == 2, np.nan, LOC + 0.05),
    "one missing": np.where(np.arange(5) // 2 == 0, np.nan, LOC + 0.02),
    "unread": np.where(np.arange(5) == 4, np.nan, LOC + 0.1),
    "nothing": np.full(5, np.nan),
}
EVERY = pytest.mark.parametrize("row", ROWS)


def rows_of(loc=LOC, dtype=F64):
    given = (torch.as_tensor(value, dtype=dtype) for value in (loc, SCALE))
    return MultivariateT(*given, (2, 2), torch.tensor(DEGREES, dtype=dtype))


def by_hand(y):
    total = 0.0
    for point in ([0, 1], [2, 3]):
        seen = [i for i in point if np.isfinite(y[i])]
        if seen:
            total += multivariate_t(LOC[seen], np.diag(SCALE[seen] ** 2), DEGREES).logpdf(y[seen])
    return total + (norm(LOC[4], SCALE[4]).logpdf(y[4]) if np.isfinite(y[4]) else 0.0)


@EVERY
def test_density_is_scipys(row):
    y = ROWS[row]
    assert rows_of().log_prob(torch.as_tensor(y)).item() == pytest.approx(by_hand(y), abs=1e-9)
    single = observed_log_prob(rows_of(dtype=torch.float32), torch.as_tensor(y, dtype=torch.float32))
    assert single.item() == pytest.approx(by_hand(y), rel=1e-4, abs=1e-4)


def test_rows_broadcast():
    """Several middles, one row that was seen; each as it is by itself."""
    y = torch.as_tensor(ROWS["half missing"])
    middles = torch.as_tensor(LOC) + 0.01 * torch.arange(3, dtype=F64)[:, None]
    together = gaussian_rows(rows_of(middles), y)
    for number, middle in enumerate(middles):
        for all_of_them, alone in zip(together, gaussian_rows(rows_of(middle), y), strict=True):
            torch.testing.assert_close(all_of_them[number], alone)


@EVERY
def test_reweighted_rows_touch_the_density_and_stay_below_it(row):
    """Value and slope are equal in the middle; elsewhere the bound holds."""
    y = torch.as_tensor(ROWS[row])
    middle = torch.as_tensor(LOC).requires_grad_()
    whitening, constant = gaussian_rows(rows_of(), y)
    filled = torch.where(torch.isnan(y), 0.0, y)

    def bound(h):
        return constant - 0.5 * (whitening * (filled - h)).square().sum()

    def exact(h):
        return MultivariateT(h, torch.as_tensor(SCALE), (2, 2), torch.tensor(DEGREES, dtype=F64)).log_prob(y)

    assert bound(middle).item() == pytest.approx(exact(middle).item(), abs=1e-9)
    (slope,) = torch.autograd.grad(bound(middle), middle)
    (own,) = torch.autograd.grad(exact(middle), middle)
    torch.testing.assert_close(slope, own, rtol=1e-9, atol=1e-9)
    rng = np.random.default_rng(0)
    for step in rng.normal(size=(20, 5)) * SCALE * 3:
        there = torch.as_tensor(LOC + step)
        assert bound(there) <= exact(there) + 1e-9


def test_drawn_rows_have_that_law_and_coordinates_stray_together():
    torch.manual_seed(0)
    drawn = ((rows_of().expand((3,)).sample((4000,)) - torch.as_tensor(LOC)) / torch.as_tensor(SCALE)).numpy()
    assert drawn.shape == (4000, 3, 5)
    flat = drawn.reshape(-1, 5)
    for entry, law in ((0, t(DEGREES)), (3, t(DEGREES)), (4, norm)):
        assert kstest(flat[:, entry], law.cdf).pvalue > 1e-3
    far = np.abs(flat) > 3
    by_chance = far.mean(0)
    assert (far[:, 0] & far[:, 1]).mean() > 5 * by_chance[0] * by_chance[1]
    apart = by_chance[0] * by_chance[2]
    assert abs((far[:, 0] & far[:, 2]).mean() - apart) < 4 * np.sqrt(apart / len(flat))


def test_an_observation_of_this_family_begins_with_degrees_of_freedom():
    links = [Link("a", "base", "elbow", 1.0, 1.0), Link("b", "elbow", "tip", 1.0, 1.0)]
    observation = Observation(Keypoints([1]), Encoders(), family="multivariate_t").bound(planar_body("arm", links))
    assert observation.defaults(1.0)["emission.df"].shape == (1,)
