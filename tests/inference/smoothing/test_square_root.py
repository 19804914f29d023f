"""The backward recursion against one big Gaussian, solved by brute force."""

import numpy as np
import oracles
import pytest
from oracles import CHAIN_DIM as DIM
from oracles import chain_numbers

from invdyn.inference.smoothing import square_root
from invdyn.inference.smoothing.square_root import backward, forward_covariance, forward_mean


def assert_agrees(numbers, rtol=1e-9):
    factors = backward(*numbers)
    mean, cov, log_integral = oracles.dense_posterior(*numbers)
    scale = np.sqrt(np.diagonal(cov, axis1=1, axis2=2)).max() + np.abs(mean).max()
    assert forward_mean(factors, numbers[5]) == pytest.approx(mean, rel=rtol, abs=rtol * scale)
    assert forward_covariance(factors) == pytest.approx(cov, rel=rtol, abs=rtol * scale**2)
    assert factors.log_evidence == pytest.approx(log_integral, rel=rtol, abs=1e-9)
    return factors


@pytest.mark.parametrize("extra", [0, 1, 4])
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_mean_covariance_and_evidence(rows, extra):
    assert_agrees(chain_numbers(1, rows=rows, extra=extra))


def test_two_rows_of_time():
    assert_agrees(chain_numbers(2, steps=2, extra=2))


def test_nothing_seen_is_the_prior():
    numbers = chain_numbers(3, extra=2)
    numbers[3][:], numbers[4][:] = 0.0, 0.0
    factors = assert_agrees(numbers)
    assert factors.log_evidence == pytest.approx(0.0, abs=1e-12)


def test_rows_seen_only_here_and_there():
    numbers = chain_numbers(4)
    numbers[3][[0, 2, 3]], numbers[4][[0, 2, 3]] = 0.0, 0.0
    numbers[3][4, 0], numbers[4][4, 0] = 0.0, 0.0
    assert_agrees(numbers)


@pytest.mark.parametrize("extra", [0, 2])
def test_singular_noise(extra):
    numbers = chain_numbers(5, extra=extra)
    numbers[2][:, 1] = 0.0  # one coordinate moves without noise
    numbers[2][3] = 0.0  # and one step is wholly deterministic
    assert_agrees(numbers)


def test_sharp_observations_keep_their_digits():
    """Noise from 1e-9 to 1 side by side: nothing is squared, so half the digits stay."""
    numbers = chain_numbers(6)
    sharpness = 10.0 ** np.arange(0, 3 * len(numbers[2]), 3).clip(0, 9)
    numbers[3] *= sharpness[:, None, None]
    numbers[4] *= sharpness[:, None]
    factors = backward(*numbers)
    path = forward_mean(factors, numbers[5])
    residual = np.einsum("tod,td->to", numbers[3], path) - numbers[4]
    # two rows against three coordinates that can move: sharp ones are met to their own noise
    assert np.abs(residual[3:]).max() < 10
    assert np.isfinite(factors.log_evidence)
    assert (np.linalg.eigvalsh(forward_covariance(factors)) > -1e-15).all()


def test_evidence_against_the_kalman_filter_with_its_normalisers():
    chain = oracles.random_chain(7)
    y = oracles.with_gaps(chain.simulate(9, seed=7)[1])
    whiten = np.linalg.inv(np.linalg.cholesky(chain.R))
    E, e, constant = np.zeros((9, 2, 3)), np.zeros((9, 2)), 0.0
    for t, row in enumerate(y):
        seen = np.isfinite(row)
        if not seen.any():
            continue
        whiten = np.linalg.inv(np.linalg.cholesky(chain.R[np.ix_(seen, seen)]))
        E[t, : seen.sum()], e[t, : seen.sum()] = whiten @ chain.C[seen], whiten @ row[seen]
        constant += np.log(np.diag(whiten)).sum() - 0.5 * seen.sum() * np.log(2 * np.pi)
    L = np.stack([np.linalg.cholesky(chain.P)] + 8 * [np.linalg.cholesky(chain.Q)])
    factors = backward(np.stack(8 * [chain.A]), np.zeros((8, 3)), L, E, e, chain.m)
    assert factors.log_evidence + constant == pytest.approx(oracles.kalman(chain, y)[0], rel=1e-10)
    means, covs = oracles.rts(chain, y)
    assert forward_mean(factors, chain.m) == pytest.approx(means, abs=1e-9)
    assert forward_covariance(factors) == pytest.approx(covs, abs=1e-9)


@pytest.mark.parametrize("rows", [2, 6])
def test_blocks_of_rows_join(rows, monkeypatch):
    """Transitions are prepared by blocks, here of three rows; more entries than states are condensed first."""
    monkeypatch.setattr(square_root, "ROWS_AT_ONCE", 3)
    assert_agrees(chain_numbers(1, rows=rows, extra=2, steps=9))


def test_factors_move_with_the_path_they_are_about():
    """Deviations from another path: the same posterior, and the same evidence."""
    numbers = chain_numbers(3, rows=2, extra=2)
    F, a, L, E, e, m0, V = numbers
    shift = np.random.default_rng(0).normal(size=(len(L), DIM))
    moved = backward(*numbers).seen_from(shift)
    onward = np.einsum("tij,tj->ti", F, shift[:-1])
    there = backward(F, a + onward - shift[1:], L, E, e - np.einsum("tij,tj->ti", E, shift), m0 - shift[0], V)
    for name in ("b", "alpha", "offset", "a", "log_c", "log_n", "log_evidence"):
        assert getattr(moved, name) == pytest.approx(getattr(there, name), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("extra", [0, 2])
def test_a_batch_is_a_loop(extra):
    numbers = chain_numbers(8, extra=extra, batch=(2, 4))
    together = backward(*numbers)
    means, covs = forward_mean(together, numbers[5]), forward_covariance(together)
    assert together.log_evidence.shape == (2, 4)
    for i in np.ndindex(2, 4):
        alone = backward(*(None if x is None else x[i] for x in numbers))
        assert together.log_evidence[i] == pytest.approx(alone.log_evidence, rel=1e-12)
        assert means[i] == pytest.approx(forward_mean(alone, numbers[5][i]), rel=1e-9, abs=1e-9)
        assert covs[i] == pytest.approx(forward_covariance(alone), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("extra", [0, 2])
def test_psi_is_the_likelihood_of_all_that_is_still_to_be_seen(extra):
    """ψ_t(x), and its integral over the step before, against the brute-force integral from x_t on."""
    F, a, L, E, e, m0, V = chain_numbers(9, extra=extra)
    factors = backward(F, a, L, E, e, m0, V)
    rng = np.random.default_rng(0)
    for t in range(len(L) - 1):
        x = rng.normal(size=DIM)
        # x_t known: a chain that starts there with noise zero
        start = np.concatenate([np.zeros((1, DIM, DIM)), L[t + 1 :]])
        tail = None if V is None else V[t:]
        known = oracles.dense_posterior(F[t:], a[t:], start, E[t:], e[t:], x, tail)[2]
        psi = factors.log_c[t] - 0.5 * np.sum((factors.U[t] @ x - factors.b[t]) ** 2)
        assert psi == pytest.approx(known, rel=1e-9)
        # x_t ~ N(x, L_t L_tᵀ)
        integral = oracles.dense_posterior(F[t:], a[t:], L[t:], E[t:], e[t:], x, tail)[2]
        found = factors.log_n[t] - 0.5 * np.sum((factors.A[t] @ x - factors.alpha[t]) ** 2)
        assert found == pytest.approx(integral, rel=1e-9)
