"""Observations that jump out of their neighbours' course: stray detections and exchanged labels are no fast arm.

A Hampel filter (Hampel 1974) about parabolas instead of a median, as an arm in motion is nowhere near its neighbours'
median: through every three of the six neighbours y_{t±1}, y_{t±2}, y_{t±3} goes a parabola p, twenty in all, and with
d_t the fourth smallest of the distances |y_t − p(t)|, y_t jumps where d_t > 7 × that of most rows. Two of the six may
have jumped themselves: four parabolas do without them.

The first two and the last two rows have three or four neighbours; they are measured by what the same neighbours tell of
all rows, by the smallest of the distances.

Shapes: T rows, O columns.
"""

from itertools import combinations

import numpy as np
import torch
from torch import Tensor

NEIGHBOURS = (-3, -2, -1, 1, 2, 3)
CLEAN = 4
"""Parabolas that go without two of the neighbours."""
JUMP, MOST = 7.0, 0.75
"""Times the upper quartile of the distances."""
FEWEST = 10
"""Parabolas, under which nothing is said of a row."""
EDGES = {0: (1, 2, 3), 1: (-1, 1, 2, 3), -2: (-3, -2, -1, 1), -1: (-3, -2, -1)}
"""Neighbours of the first rows and the last."""
EXACT = 1e-9
"""Of an observation's size: nearer to a parabola is rounding."""


def calm(time: Tensor, observations: Tensor) -> Tensor:
    """Observations (T, O) at ``time`` (T,) s, NaN where they jump."""
    values = observations.numpy()
    when = time.numpy()[:, None]
    jumps = _jumps(_beside_parabolas(when, values, NEIGHBOURS, CLEAN, FEWEST), values)
    if len(values) > 2 * max(NEIGHBOURS):
        for row, near in EDGES.items():
            jumps[row] = _jumps(_beside_parabolas(when, values, near, 1, 1), values)[row]
    return torch.as_tensor(np.where(jumps, np.nan, values))


def _jumps(away: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Which of ``values`` (T, O) are farther from their neighbours' parabolas than most."""
    usual = np.array([_usual(column[np.isfinite(column)]) for column in away.T])
    # Of what is on its neighbours' course exactly, as at rest in rounded numbers, nobody knows what is usual.
    known = usual > EXACT * np.nan_to_num(np.abs(values)).max(0)
    return known & (away > JUMP * usual)


def _usual(away: np.ndarray) -> float:
    return float(np.quantile(away, MOST)) if len(away) else 0.0


def _beside_parabolas(
    time: np.ndarray, values: np.ndarray, neighbours: tuple[int, ...], place: int, fewest: int
) -> np.ndarray:
    """Distances d (T, O), the smallest but ``place`` − 1, of ``values`` at ``time`` (T, 1).

    NaN where fewer than ``fewest`` parabolas are known.
    """
    when = {k: _shifted(time, k) for k in neighbours}
    what = {k: _shifted(values, k) for k in neighbours}

    def parabola(i: int, j: int, k: int) -> np.ndarray:
        return sum(
            what[a] * (time - when[b]) * (time - when[c]) / ((when[a] - when[b]) * (when[a] - when[c]))
            for a, b, c in ((i, j, k), (j, i, k), (k, i, j))
        )

    away = np.sort([np.abs(values - parabola(*three)) for three in combinations(neighbours, 3)], axis=0)  # NaN last
    return np.where(np.isfinite(away).sum(0) < fewest, np.nan, away[place - 1])


def _shifted(rows: np.ndarray, by: int) -> np.ndarray:
    """Rows (T, C) of so many rows later; NaN beyond the ends."""
    most = max(NEIGHBOURS)
    padded = np.pad(rows, ((most, most), (0, 0)), constant_values=np.nan)
    return padded[most + by : most + by + len(rows)]
