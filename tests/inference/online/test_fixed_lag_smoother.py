"""The fixed-lag smoother: on linear models the exact smoother given rows up to t + L, on arms Gauss–Newton's."""

import numpy as np
import oracles
import pytest
import torch
from stiff_arm import arm

from invdyn.inference import FixedLagSmoother, ModelError, gauss_newton

ROWS = 40


def run(model, y, lag, order=None, **options):
    smoother = FixedLagSmoother(model, lag, **options)
    found = [each for t in (range(len(y)) if order is None else order) for each in smoother.add(t, y[t])]
    return smoother, [*found, *smoother.finish()]


@pytest.fixture(scope="module", name="chain")
def a_chain():
    return oracles.random_chain(seed=5)


@pytest.fixture(scope="module", name="y")
def observed(chain):
    return oracles.with_gaps(chain.simulate(ROWS, seed=5)[1])


@pytest.mark.parametrize("lag", [0, 1, 4, 9])
def test_a_linear_model_has_the_exact_smoother_at_that_lag(chain, y, lag):
    _, found = run(chain.model(12), y, lag)
    assert [each.t for each in found] == list(range(ROWS))
    for each in found:
        means, covs = oracles.rts(chain, y[: each.last + 1])
        assert each.mean == pytest.approx(means[each.t], abs=1e-9)
        assert each.covariance == pytest.approx(covs[each.t], abs=1e-9)


def test_rows_may_be_wider_than_the_state():
    wide = oracles.random_chain(seed=6, dim=2, size=5)
    y = wide.simulate(ROWS, seed=6)[1]
    for each in run(wide.model(12), y, 3)[1]:
        means, covs = oracles.rts(wide, y[: each.last + 1])
        assert each.mean == pytest.approx(means[each.t], abs=1e-9)
        assert each.covariance == pytest.approx(covs[each.t], abs=1e-9)


def test_the_answer_comes_with_the_row_a_lag_later(chain, y):
    found = run(chain.model(12), y, 8)[1]
    assert all(each.last == min(each.t + 8, ROWS - 1) for each in found)


def test_innovations_are_those_of_the_kalman_filter(chain, y):
    _, found = run(chain.model(12), y, 3)
    mean, cov = chain.m, chain.P
    for t, row in enumerate(y):
        if t > 0:
            mean, cov = chain.A @ mean, chain.A @ cov @ chain.A.T + chain.Q
        seen = np.isfinite(row)
        S = chain.C[seen] @ cov @ chain.C[seen].T + chain.R[np.ix_(seen, seen)]
        off = row[seen] - chain.C[seen] @ mean
        if t >= 6 and seen.any():
            z = found[t].innovation
            assert np.isfinite(z).sum() == seen.sum()  # a missing entry is none that was as predicted
            assert (z[np.isfinite(z)] ** 2).sum() == pytest.approx(off @ np.linalg.solve(S, off), rel=1e-8)
        gain = cov @ chain.C[seen].T @ np.linalg.inv(S)
        mean, cov = mean + gain @ off, cov - gain @ S @ gain.T


def test_rows_late_lost_and_doubled(chain, y):
    """Row 12 comes after row 15, row 20 never, row 25 twice, and row 8 far too late."""
    order = [t for t in range(ROWS) if t not in (8, 12, 20)]
    order.insert(order.index(15) + 1, 12)
    order.insert(order.index(25) + 1, 25)
    order.insert(order.index(35), 8)
    smoother, found = run(chain.model(12), y, 6, order)
    counts = smoother.counts
    assert (counts.rows, counts.lost, counts.late, counts.doubled) == (ROWS, 2, 1, 1)
    without = y.copy()
    without[[8, 20]] = np.nan
    for each in found:
        if each.last in (12, 13, 14, 15):
            continue  # row 12 was not there yet
        means, covs = oracles.rts(chain, without[: each.last + 1])
        assert each.mean == pytest.approx(means[each.t], abs=1e-9)
        assert each.covariance == pytest.approx(covs[each.t], abs=1e-9)


def test_the_first_row_of_a_number_stands(chain, y):
    """Row 25 again, with other values: they fill in what was missing, and change nothing that was seen."""
    rows, partial = y.copy(), y.copy()
    rows[25] = np.where(np.isnan(y[25]), 0.3, y[25])
    partial[25] = np.where(np.arange(len(y[25])) == 0, np.nan, rows[25])
    smoother = FixedLagSmoother(chain.model(12), 6)
    found = [each for t in range(26) for each in smoother.add(t, partial[t])]
    smoother.add(25, np.where(np.arange(len(y[25])) == 0, rows[25], rows[25] + 5.0))
    found += [each for t in range(26, ROWS) for each in smoother.add(t, y[t])]
    for each in found:
        means, covs = oracles.rts(chain, (partial if each.last == 25 else rows)[: each.last + 1])
        assert each.mean == pytest.approx(means[each.t], abs=1e-9)
        assert each.covariance == pytest.approx(covs[each.t], abs=1e-9)


def test_the_start_waits_for_a_row_that_shows_something(chain, y):
    rows = y.copy()
    rows[:5] = np.nan
    _, found = run(chain.model(12), rows, 2)
    assert [each.t for each in found] == list(range(5, ROWS))


@pytest.mark.quick("0.002")
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_an_arm_is_as_its_smoother_has_it(noise):
    """Up to linearisation: a tenth of a standard deviation in the median, of a smoother given rows up to t + L."""
    model = arm(45, noise)
    torch.manual_seed(3)
    y = model.simulate()[1]
    _, found = run(model, y, 5)
    off, ratio = [], []
    for each in found[3::9]:
        rows = y.clone()
        rows[each.last + 1 :] = torch.nan
        smoother = gauss_newton(model, rows)
        sd = smoother.covariance()[each.t].diagonal().sqrt().numpy()
        off.append(np.abs(each.mean - smoother.path[each.t].numpy()) / sd)
        ratio.append(each.sd / sd)
    assert np.median(off) < 0.02
    assert np.quantile(off, 0.95) < 0.3
    assert np.exp(np.abs(np.log(ratio)).mean()) < 1.05


def test_what_cannot_be_is_refused(chain):
    with pytest.raises(ValueError, match="lag of 0 rows or more"):
        FixedLagSmoother(chain.model(12), -1)
    with pytest.raises(ValueError, match="model of more than 20 rows"):
        FixedLagSmoother(chain.model(12), 19)
    with pytest.raises(ModelError, match="expected row 3 of shape"):
        FixedLagSmoother(chain.model(12), 1).add(3, np.zeros(7))
