"""What counts as a simulation that diverged, and what does not."""

import numpy as np
import pytest
import torch

from invdyn.models.divergence import Diverged, Singular, diverging

NAN = np.full((2, 2), np.nan)


@pytest.mark.parametrize(
    "work",
    [
        lambda: np.linalg.inv(np.zeros((2, 2))),
        lambda: np.linalg.solve(np.zeros((2, 2)), np.ones(2)),
        lambda: np.linalg.cholesky(-np.eye(2)),
        lambda: np.linalg.svd(NAN),
        lambda: torch.linalg.cholesky(-torch.eye(2)),
        lambda: torch.linalg.solve(torch.zeros(2, 2), torch.ones(2)),
    ],
)
def test_a_matrix_without_factors_is_divergence(work):
    with pytest.raises(Singular) as caught, diverging():
        work()
    assert isinstance(caught.value, Diverged)


@pytest.mark.parametrize(
    "work",
    [
        lambda: np.linalg.inv(np.zeros((2, 3))),
        lambda: np.linalg.cholesky(np.ones(2)),
        lambda: np.linalg.solve(np.ones((2, 3)), np.ones(2)),
        lambda: torch.linalg.cholesky(torch.ones(2, 3)),
        lambda: np.ones(2) + np.ones(3),
        lambda: torch.ones(2) + torch.ones(3),
        lambda: {}["name"],
    ],
)
def test_a_slip_is_not(work):
    with pytest.raises((ValueError, RuntimeError, KeyError)) as caught, diverging():
        work()
    assert not isinstance(caught.value, Diverged)
