"""What torques tell of the rest of a process' state, against the Gaussian of all rows."""

import pytest
import torch

from invdyn.models import Matern32, Matern52, SmoothAndRough
from invdyn.models.torques.given_torques import given_torques

TIME = torch.tensor([0.0, 0.03, 0.06, 0.12, 0.15, 0.18], dtype=torch.float64)
K, Z_T = 2, len(TIME) - 1


def all_rows(process, numbers):
    """Covariance (T·Z, T·Z) of z in all rows, by the chain's own matrices."""
    size, intervals = process.size(K), torch.diff(TIME)
    root = process.stationary(intervals[0], numbers)
    blocks = [[root @ root.mT]]
    for dt in intervals:
        A = process.mean(torch.eye(size, dtype=torch.float64), dt, numbers).mT
        noise = process.noise(dt, numbers)
        blocks.append([A @ each for each in blocks[-1]] + [A @ blocks[-1][-1] @ A.mT + noise @ noise.mT])
    whole = torch.zeros(len(TIME) * size, len(TIME) * size, dtype=torch.float64)
    for i, row in enumerate(blocks):
        for j, block in enumerate(row):
            whole[i * size : (i + 1) * size, j * size : (j + 1) * size] = block
            whole[j * size : (j + 1) * size, i * size : (i + 1) * size] = block.mT
    return whole


@pytest.mark.parametrize("process", [Matern32(0.2), Matern52(0.2), SmoothAndRough()], ids=lambda p: type(p).__name__)
def test_it_is_the_conditional_of_all_rows(process):
    numbers = process.defaults(torch.tensor([2.0, 0.5], dtype=torch.float64))
    size, whole = process.size(K), all_rows(process, numbers)
    seen = torch.cat([torch.arange(K) + row * size for row in range(len(TIME))])
    last = torch.arange(size) + Z_T * size
    root = torch.linalg.cholesky(whole[seen][:, seen])
    torques = torch.randn(3, len(seen), dtype=torch.float64) @ root.mT  # paths as the process has them
    gain = torch.linalg.solve(whole[seen][:, seen], whole[seen][:, last]).mT
    mean, covariance = given_torques(process, torques.reshape(3, len(TIME), K), TIME, numbers)
    expected = whole[last][:, last] - gain @ whole[seen][:, last]
    sd = whole[last, last].sqrt()
    assert ((mean - torques @ gain.mT) / sd).abs().max() < 1e-6
    assert ((covariance - expected) / sd / sd[:, None]).abs().max() < 1e-6
    assert mean[:, :K].numpy() == pytest.approx(torques[:, -K:].numpy())
