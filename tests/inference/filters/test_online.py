"""Filters and smoothers that take rows as they come, against Kalman and Rauch–Tung–Striebel."""

import itertools
import weakref

import numpy as np
import oracles
import pytest
import torch
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import (
    Bootstrap,
    Controlled,
    ParticleFilter,
    backward_simulation,
    filter_rows,
    fixed_lag,
    genealogy,
    paris,
)
from invdyn.inference.contract import ModelError

T = 40


@pytest.fixture(scope="module")
def chain():
    return oracles.noisy_chain()


@pytest.fixture(scope="module")
def y(chain):
    return torch.as_tensor(oracles.with_gaps(chain.simulate(T, seed=1)[1]))


# -- the filter --------------------------------------------------------------------------------------
@pytest.mark.quick("0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
def test_the_filter_agrees_with_kalman(chain, y, threshold):
    model = chain.model(T)
    rows = list(filter_rows(model, iter(y), 300, seed=1, num_filters=800, ess_threshold=threshold))
    exact, increments, means, _ = oracles.kalman(chain, y.numpy())
    oracles.assert_unbiased(rows[-1].log_evidence, exact)
    # Weighted by their evidence, a filter's means have no bias.
    for row in (rows[9], rows[-1]):
        ratio = torch.exp(row.log_evidence - increments[: row.t + 1].sum()).unsqueeze(-1)
        off = ratio * (row.mean(row.states) - torch.as_tensor(means[row.t]))
        assert (off.mean(0).abs() < 4 * off.std(0) / len(off) ** 0.5).all()


def test_it_hands_on_one_row_back(chain, y):
    rows = list(filter_rows(chain.model(T), y, 10, seed=1))
    assert rows[0].previous is None
    for before, row in itertools.pairwise(rows):
        assert torch.equal(row.previous.states, before.states)
        assert row.previous.previous is None


def test_what_is_drawn_between_rows_changes_nothing(chain, y):
    model = chain.model(T)
    plain = [row.log_evidence for row in filter_rows(model, y, 20, seed=3)]
    disturbed = []
    for row in filter_rows(model, y, 20, seed=3):
        torch.randn(7)
        disturbed.append(row.log_evidence)
    assert torch.equal(torch.stack(plain), torch.stack(disturbed))
    expected = torch.rand(3, generator=torch.Generator().manual_seed(5))
    torch.manual_seed(5)
    next(iter(filter_rows(model, y, 20, seed=3)))
    assert torch.equal(torch.rand(3), expected)


def test_rows_are_taken_as_they_come(chain):
    """An endless source: each row is answered before the next is read."""
    read = []

    def source():
        for t in itertools.count():
            read.append(t)
            yield torch.zeros(2, dtype=torch.float64)

    model = chain.model(3)
    for row in itertools.islice(filter_rows(model, source(), 5, seed=0), 10):
        assert read[-1] == row.t
    lagged = fixed_lag(model, source(), 5, lag=4, seed=0)
    assert [next(lagged).t for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ess_threshold": 0.0}, "ess_threshold in"),
        ({"num_filters": 0}, "at least one particle and filter"),
        ({"twisted": True}, "without a twist"),
    ],
)
def test_bad_arguments_are_refused_before_a_row_is_read(chain, y, options, message):
    model = chain.model(T)
    if options.pop("twisted", False):
        options["guide"] = Controlled(model, y)
    with pytest.raises(ValueError, match=message):
        filter_rows(model, y, 10, seed=0, **options)


def test_rows_are_arrays_or_tensors_of_one_length(chain, y):
    model = chain.model(T)
    one, other = (list(filter_rows(model, rows, 10, seed=0))[-1] for rows in (y, y.numpy()))
    assert torch.equal(one.log_evidence, other.log_evidence)
    with pytest.raises(ModelError, match=r"expected row 0 of shape \(2,\), got \(3,\)"):
        next(filter_rows(model, [torch.zeros(3)], 10, seed=0))


def test_a_row_out_of_reach_is_named(chain, y):
    far = y.clone()
    far[6] = 1e200
    with pytest.raises(SMCFailed, match="row 6"):
        list(filter_rows(chain.model(T), far, 10, seed=0))


# -- PaRIS -------------------------------------------------------------------------------------------
def sums(previous, state, t):
    """Of each state: Σ x_t, and Σ x_{t−1} x_t of the first."""
    product = torch.zeros_like(state[..., :1]) if previous is None else previous[..., :1] * state[..., :1]
    return torch.cat([state, product], -1)


def exact_sums(chain, y, rows):
    """E[Σ x_t | y] of both states, and E[Σ x_{t−1} x_t | y] of the first, of the first so many rows."""
    y = y[:rows].numpy()
    means, covs = oracles.rts(chain, y)
    _, _, _, filtered = oracles.kalman(chain, y)
    product = 0.0
    for t in range(rows - 1):
        predicted = chain.A @ filtered[t] @ chain.A.T + chain.Q
        across = filtered[t] @ chain.A.T @ np.linalg.inv(predicted) @ covs[t + 1]
        product += across[0, 0] + means[t, 0] * means[t + 1, 0]
    return np.array([*means.sum(0), product])


@pytest.mark.quick("*-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("backward", ["mcmc", "exact"])
def test_paris_agrees_with_kalman(chain, y, backward, threshold):
    size, y = 200 if backward == "mcmc" else 80, y[:24]
    estimates = list(
        paris(chain.model(T), y, sums, size, seed=1, num_filters=60, backward=backward, ess_threshold=threshold)
    )
    assert [estimate.t for estimate in estimates] == list(range(24))
    for rows in (12, 24):
        value = estimates[rows - 1].value
        assert value.shape == (60, 3)
        exact = exact_sums(chain, y, rows)
        error = value.std(0) / 60**0.5
        # N particles leave a bias of order rows / N.
        assert ((value.mean(0) - torch.as_tensor(exact)).abs() < 4 * error + 0.3 * rows / size).all()


@pytest.mark.long
def test_paris_has_less_variance_than_the_genealogy(chain):
    """Over many rows the first row's mean is lost with one line, and kept with two."""
    y = torch.as_tensor(chain.simulate(60, seed=2)[1])
    model = chain.model(60)

    def first(previous, state, t):
        return state[..., 0] if previous is None else torch.zeros_like(state[..., 0])

    *_, last = paris(model, y, first, 60, seed=1, num_filters=100, ess_threshold=1.0)
    mean = oracles.rts(chain, y.numpy())[0][0, 0]
    assert last.value.shape == (100,)
    assert abs(last.value.mean() - mean) < 4 * last.value.std() / 10 + 0.02

    result = ParticleFilter(model, Bootstrap(model), 60, num_filters=100, ess_threshold=1.0).run(y)
    lines = genealogy(result, 60)[..., 0, 0].mean(-1)
    assert last.value.var() < 0.3 * lines.var()
    exact = backward_simulation(model, result, y, 60)[..., 0, 0].mean(-1)
    assert last.value.var() < 4 * exact.var()


def test_paris_refuses_what_it_cannot_do(chain, y):
    for options in ({"backward_draws": 1}, {"backward": "best"}):
        with pytest.raises(ValueError, match="two backward draws or more"):
            paris(chain.model(T), y, sums, 10, seed=0, **options)


# -- fixed lag ---------------------------------------------------------------------------------------
@pytest.mark.quick("*-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("lag", [0, 3, 12, 100])
def test_fixed_lag_agrees_with_rts_of_as_many_rows(chain, y, lag, threshold):
    if lag == 100:
        y = y[:12]  # the lines of all rows still differ
    steps = len(y)
    rows = list(fixed_lag(chain.model(T), y, 400, lag=lag, seed=1, num_filters=60, ess_threshold=threshold))
    assert [row.t for row in rows] == list(range(steps))
    assert [row.last for row in rows] == [min(t + lag, steps - 1) for t in range(steps)]
    for row in rows:
        means, covs = oracles.rts(chain, y[: row.last + 1].numpy())
        mean, variance = row.mean, row.variance
        error = mean.std(0) / 60**0.5
        assert ((mean.mean(0) - torch.as_tensor(means[row.t])).abs() < 4.5 * error + 0.01).all()
        exact = torch.as_tensor(np.diagonal(covs[row.t]).copy())
        assert ((variance.mean(0) / exact - 1).abs() < 0.1).all()


def test_a_negative_lag_is_refused(chain, y):
    with pytest.raises(ValueError, match="lag of 0 rows or more"):
        fixed_lag(chain.model(T), y, 5, lag=-1, seed=0)


@pytest.mark.parametrize("method", ["filter", "paris", "lag"])
def test_particles_kept_do_not_grow_with_the_number_of_rows(chain, method):
    model, met = chain.model(3), []
    rows = (torch.zeros(2, dtype=torch.float64) for _ in range(200))

    def watched(previous, state, t):
        met.append(weakref.ref(state))
        return state

    if method == "paris":
        items = paris(model, rows, watched, 20, seed=0)
    else:
        items = fixed_lag(model, rows, 20, lag=5, seed=0) if method == "lag" else filter_rows(model, rows, 20, seed=0)
    for item in items:
        if method != "paris":
            met.append(weakref.ref(item.states))
        assert sum(ref() is not None for ref in met) < 10
    assert len(met) >= 200
