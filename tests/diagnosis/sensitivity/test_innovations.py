"""Whitened innovations against the joint Gaussian of the whole recording, written out as one big matrix."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from invdyn.diagnosis.sensitivity.innovations import gains, innovations

T, D, O, J = 9, 3, 2, 2


def chain(seed=0, levels=(0.3, 1.0, 2.0), missing=True):
    """Numbers of a chain whose matrices change from row to row; row 2 is unseen, and half of row 4."""
    rng = np.random.default_rng(seed)

    def roots(*shape):
        return 0.5 * np.eye(D) + 0.2 * rng.normal(size=(*shape, D, D))

    F = 0.9 * np.eye(D) + 0.2 * rng.normal(size=(T - 1, D, D))
    Q, P0 = roots(T - 1), roots()
    Q, P0 = Q @ np.swapaxes(Q, -1, -2), P0 @ P0.T
    squares = np.array(levels) ** 2
    E, e, d = rng.normal(size=(T, O, D)), 3 * rng.normal(size=(T, O)), rng.normal(size=(T, O, J))
    if missing:
        for array in (E, e, d):
            array[2], array[4, 0] = 0.0, 0.0
    return {
        "F": F,
        "a": rng.normal(size=(T - 1, D)),
        "Q": squares[:, None, None, None] * Q,
        "E": E,
        "e": e,
        "m0": rng.normal(size=D),
        "P0": squares[:, None, None] * P0,
        "g": rng.normal(size=(T - 1, D, J)),
        "d": d,
    }


def joint(F, a, Q, E, e, m0, P0, g, d):
    """Mean (T·O, 1 + J) of what is seen, without and per unit of each input, and covariance, of one noise level."""
    mean, shift, cov = [m0], [np.zeros((D, J))], [[P0]]
    for t in range(T - 1):
        mean.append(F[t] @ mean[t] + a[t])
        shift.append(F[t] @ shift[t] + g[t])
        across = [F[t] @ block for block in cov[t]]
        cov.append([*across, across[t] @ F[t].T + Q[t]])
    seen = np.zeros((T, O, T, O))
    for s in range(T):
        for t in range(s + 1):
            seen[s, :, t] = E[s] @ cov[s][t] @ E[t].T
            seen[t, :, s] = seen[s, :, t].T
    means = [np.concatenate([(E[t] @ mean[t])[:, None], E[t] @ shift[t] + d[t]], -1) for t in range(T)]
    return np.concatenate(means), seen.reshape(T * O, T * O) + np.eye(T * O)


def whitened(F, a, Q, E, e, m0, P0, g, d):
    """Columns (G, T·O, 1 + J), and the determinants (G, T)."""
    gained = gains(F, Q, E, P0)
    return innovations(gained, F, a, E, e, m0, g, d), gained.log_det


def level(numbers, g):
    """One noise level of the numbers."""
    return numbers | {"Q": numbers["Q"][g], "P0": numbers["P0"][g]}


@pytest.mark.parametrize("missing", [False, True])
def test_columns_and_determinants_are_those_of_the_joint_gaussian(missing):
    """A Cholesky factor is unique: whitening row by row is whitening by that of the whole covariance."""
    numbers = chain(missing=missing)
    columns, log_det = whitened(**numbers)
    assert columns.shape == (3, T * O, 1 + J)
    for g in range(3):
        means, covariance = joint(**level(numbers, g))
        data = -means
        data[:, 0] += numbers["e"].reshape(-1)
        root = np.linalg.cholesky(covariance)
        np.testing.assert_allclose(columns[g], np.linalg.solve(root, data), rtol=1e-9, atol=1e-9)
        by_row = np.log(np.diag(root)).reshape(T, O).sum(-1)
        np.testing.assert_allclose(log_det[g], by_row, rtol=1e-9, atol=1e-12)


def test_density_of_the_data_under_any_input():
    """As the top of the file promises: log p(e | φ) = −½|w(φ)|² − Σ log_det − ½ n log 2π."""
    numbers = chain(seed=1)
    columns, log_det = whitened(**numbers)
    phi = np.array([0.7, -1.3])
    w = columns[..., 0] + columns[..., 1:] @ phi
    got = -0.5 * (w**2).sum(-1) - log_det.sum(-1) - 0.5 * T * O * np.log(2 * np.pi)
    for g in range(3):
        means, covariance = joint(**level(numbers, g))
        expected = multivariate_normal.logpdf(numbers["e"].reshape(-1), means @ np.r_[1.0, phi], covariance)
        assert got[g] == pytest.approx(expected, abs=1e-8)


def test_a_row_that_was_not_seen_says_nothing():
    columns, log_det = whitened(**chain())
    rows = columns.reshape(3, T, O, 1 + J)
    assert not rows[:, 2].any()
    assert not log_det[:, 2].any()
    assert rows[:, 3].all()


def test_levels_together_are_the_levels_one_by_one():
    numbers = chain(seed=2)
    columns, log_det = whitened(**numbers)
    for g in range(3):
        alone = whitened(**numbers | {"Q": numbers["Q"][g : g + 1], "P0": numbers["P0"][g : g + 1]})
        np.testing.assert_allclose(alone[0][0], columns[g], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(alone[1][0], log_det[g], rtol=1e-12, atol=1e-12)


def test_no_input_at_all():
    numbers = chain()
    none = numbers | {"g": numbers["g"][..., :0], "d": numbers["d"][..., :0]}
    np.testing.assert_allclose(whitened(**none)[0], whitened(**numbers)[0][..., :1], atol=1e-12)
