"""Sums over the rows of columns that are kept joint by joint, against those of the whole matrix."""

import numpy as np
import pytest

from invdyn.diagnosis.regression.columns import Columns

RNG = np.random.default_rng(0)
AT = (np.array([0, 2, 3]), np.array([1, 3, 5]))  # column 4 is zero everywhere
OWN = Columns(tuple(RNG.standard_normal((2, 3, 40))), AT, 6)
DENSE = np.zeros((6, 40, 2))
for k, at in enumerate(AT):
    DENSE[at, :, k] = OWN.values[k]
Y, W = RNG.standard_normal((40, 2)), RNG.random((40, 2))


def test_sums_are_those_of_the_whole_matrix():
    gram, cross, square = OWN.sums(Y, W, slice(5, 30))
    X, y, w = DENSE[:, 5:30], Y[5:30], W[5:30]
    assert gram == pytest.approx(np.einsum("prk,rk,qrk->kpq", X, w, X))
    assert cross == pytest.approx(np.einsum("prk,rk->kp", X, w * y))
    assert square == pytest.approx((w * y**2).sum(0))
    blocks = OWN.block_sums(Y, np.array([0, 10, 17]))
    assert blocks[1] == pytest.approx(np.einsum("prk,rk->p", DENSE[:, 10:17], Y[10:17]))


def test_torque_and_triangle_are_those_of_some_columns():
    some, beta = [3, 5, 0], np.array([1.0, -2.0, 0.5])
    assert OWN.torque(some, beta) == pytest.approx(np.tensordot(beta, DENSE[some], 1))
    triangle, rows = OWN.triangle(some, W), (DENSE[some] * W).reshape(3, -1)
    assert triangle.T @ triangle == pytest.approx(rows @ rows.T)
    assert OWN.moving.tolist() == [True, True, True, True, False, True]
