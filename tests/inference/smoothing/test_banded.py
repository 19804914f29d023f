"""Mean and evidence by one band Cholesky factor against the recursions, which square nothing."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import chain_numbers, dense_posterior

from invdyn.inference.smoothing.banded import chain_posterior
from invdyn.inference.smoothing.square_root import backward, forward_mean
from invdyn.models.divergence import Singular


def regular(seed=0, **sizes):
    """A random chain whose noise is regular."""
    F, a, L, E, e, m0, _ = chain_numbers(seed, **sizes)
    diagonal = np.arange(L.shape[-1])
    L[..., diagonal, diagonal] = 0.3 + np.abs(L[..., diagonal, diagonal])
    return F, a, L, E, e, m0


def assert_agrees(F, a, L, E, e, m0, V=None, rtol=1e-9, may_refuse=False):
    factors = backward(F, a, L, E, e, m0, V)
    expected = forward_mean(factors, m0)
    try:
        found, *_ = chain_posterior(F, a, L, E, e, m0, V, repair=np.inf)
    except Singular:
        assert may_refuse
        return
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol * np.abs(expected).max())
    try:
        _, evidence, _ = chain_posterior(F, a, L, E, e, m0, V)
    except Singular:
        assert may_refuse
        return
    assert evidence == pytest.approx(float(factors.log_evidence), rel=rtol, abs=1e-5)


@pytest.mark.parametrize("steps", [2, 7, 300])
@pytest.mark.parametrize("rows", [1, 3])
def test_mean(steps, rows):
    F, *rest = regular(1, steps=steps, rows=rows)
    assert_agrees(F / 2, *rest)
    assert_agrees(F / 2, *rest, np.random.default_rng(0).normal(size=(*F.shape[:2], 2)))


def test_rows_that_were_not_seen():
    F, a, L, E, e, m0 = regular(2, steps=40)
    E[10:20], e[10:20] = 0.0, 0.0
    assert_agrees(F, a, L, E, e, m0)


@settings(max_examples=40)
@given(
    seed=st.integers(0, 10**6),
    driven=st.floats(-6, 0),
    firm=st.floats(-6, 0),
    sharp=st.floats(-1, 5),
)
def test_noise_over_many_powers_of_ten(seed, driven, firm, sharp):
    """A torque that hardly moves, angles that obey to a millionth, observations from blurred to sharp.

    Where the condition is beyond repair it says so; it does not give digits that are wrong.
    """
    may_refuse = firm < -1 and sharp < 2.5
    rng = np.random.default_rng(seed)
    steps, h = 200, 0.01
    F = np.tile([[0.8, 0.0, 0.0], [h * h, 1.0, h], [h, -0.3 * h, 1.0]], (steps - 1, 1, 1))
    L = np.tile(np.diag([10.0**driven, 1e-2 * 10.0**firm, 10.0**firm]), (steps, 1, 1))
    L[0] = np.diag([10.0**driven, 1.0, 1.0])
    E = np.tile(10.0**sharp * np.array([[0.0, 1.0, 0.0]]), (steps, 1, 1))
    e = 10.0**sharp * np.sin(0.02 * np.arange(steps))[:, None] + rng.normal(size=(steps, 1))
    assert_agrees(F, rng.normal(size=(steps - 1, 3)) * 1e-3, L, E, e, rng.normal(size=3), None, 1e-6, may_refuse)


def test_draws_have_the_posteriors_covariance():
    """Of unit vectors, one by one, as the noise: their outer products add up to it."""
    numbers = (*regular(4, steps=5), np.random.default_rng(1).normal(size=(4, 3, 2)))
    size = 5 * 3
    columns = [chain_posterior(*numbers, noise=each.reshape(5, 3))[2].ravel() for each in np.eye(size)]
    covariance = np.sum([np.outer(each, each) for each in columns], axis=0)
    expected = dense_posterior(*numbers)[1]
    for t in range(5):
        np.testing.assert_allclose(covariance[3 * t : 3 * t + 3, 3 * t : 3 * t + 3], expected[t], rtol=1e-8, atol=1e-12)


def test_without_noise_it_is_refused():
    F, a, L, E, e, m0 = regular(3)
    L[2, 1, 1] = 0.0
    with pytest.raises(Singular, match="noise in every state"):
        chain_posterior(F, a, L, E, e, m0)
