"""Observations that jump out of their neighbours' course: outliers and exchanged labels are no fast arm.

A Hampel filter (Hampel 1974) about parabolas instead of a median: an arm in motion is nowhere near its neighbours'
median. Through every three of the six neighbours y_{t±1}, y_{t±2}, y_{t±3} passes a parabola p, twenty in all. Let d_t
be the fourth smallest of the distances |y_t − p(t)|. Then y_t jumps where d_t > 7 × that of most rows. Two of the six
may have jumped themselves: four parabolas do without them.

The first three and the last three rows have fewer neighbours: each is measured by one parabola through rows on its
inner side, the outermost row last, as the same parabola measures all rows; 5 times are too far there.

Before that, labels that a tracker has exchanged are put right where the links' lengths say so. A rigid link's ends are
its length L apart. Let r = max |‖p_i − p_{i−1}‖ − L_i| over the links whose ends are tracked; the first link's inner
end is the base. A row is put right where r is far above what it is in most rows, and is not once the labels of two
keypoints are exchanged. It only serves to find a first path: how often labels are exchanged, an effect says, from the
detections as they are.

Shapes: T rows, O columns, P keypoints.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArmModel

BEYOND = ((1, 3, 4), (1, 2, 4), (1, 2, 3), (2, 3, 4))
"""Neighbours from which a parabola extrapolates, those first beyond which noise moves it least."""
BACK = tuple(tuple(-k for k in near) for near in BEYOND)
EDGES = {2: BEYOND, -3: BACK, 1: BEYOND, -2: BACK, 0: BEYOND, -1: BACK}
"""Neighbours of the first rows and the last: the first ones of which none jumped or is missing count."""


def calm(time: Tensor, observations: Tensor, starts: Sequence[int] = ()) -> Tensor:
    """Observations (T, O) at ``time`` (T,) s, NaN where they jump; at ``starts`` further recordings begin."""
    parts = zip(np.split(time.numpy(), starts), np.split(observations.numpy(), starts), strict=True)
    return torch.as_tensor(np.concatenate([_calm(when[:, None], values) for when, values in parts]))


def _calm(when: np.ndarray, values: np.ndarray) -> np.ndarray:
    away = _distances(when, values, FIXED.neighbour_rows, FIXED.outlier_rank, FIXED.min_parabolas)
    jumps = _jumps(away, values, FIXED.outlier_ratio)
    ends = list(EDGES) if len(values) > len(EDGES) else []
    jumps[ends] = False
    left = np.where(jumps, np.nan, values)
    for row in ends:
        open_ones = np.isfinite(left[row])
        for near in EDGES[row]:
            away = _distances(when, left, near, 1, 1)
            known = open_ones & np.isfinite(away[row])
            left[row, known & _jumps(away, left, FIXED.edge_outlier_ratio)[row]] = np.nan
            open_ones &= ~known
    return left


def _jumps(away: np.ndarray, values: np.ndarray, times: float) -> np.ndarray:
    """Which of ``values`` (T, O) are so many times farther from their neighbours' parabolas than most."""
    usual = np.array([_usual(column[np.isfinite(column)]) for column in away.T])
    # Of what is on its neighbours' course exactly, as at rest in rounded numbers, no distance is usual.
    known = usual > FIXED.rounding * np.nan_to_num(np.abs(values)).max(0)
    return known & (away > times * usual)


def _usual(away: np.ndarray) -> float:
    return float(np.quantile(away, FIXED.outlier_quantile)) if len(away) else 0.0


def _distances(
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
    beyond = abs(by)
    padded = np.pad(rows, ((beyond, beyond), (0, 0)), constant_values=np.nan)
    return padded[beyond + by : beyond + by + len(rows)]


def relabelled(model: ArmModel, observations: Tensor) -> Tensor:
    """Observations (T, O) with exchanged labels put right; as they are where fewer than two keypoints
    are tracked, and of a body that is no chain in the plane.
    """
    if not model.body.is_chain:
        return observations
    tips = model.observation.tracked
    points = model.observation.points(observations).numpy()
    body = model.body_parameters()
    length, base = body.length.numpy(), body.base.numpy()
    links = [k for k in tips if k == 0 or k - 1 in tips]

    def misfit(points: np.ndarray) -> np.ndarray:
        """The r of each row (T,), m; 0 where no link has both ends."""
        found = np.zeros(len(points))
        for k in links:
            inner = points[:, tips.index(k - 1)] if k else base
            apart = np.linalg.norm(points[:, tips.index(k)] - inner, axis=-1)
            found = np.fmax(found, np.abs(apart - length[k]))
        return found

    own = misfit(points)
    least = FIXED.label_misfit_ratio * max(float(np.median(own)), FIXED.rounding * float(length.sum()))
    best, put_right = own, points
    for i, j in combinations(range(len(tips)), 2):
        other = points.copy()
        other[:, [i, j]] = points[:, [j, i]]
        there = misfit(other)
        better = (own > least) & (there < np.minimum(best, least)) & np.isfinite(other[:, [i, j]]).all((1, 2))
        best, put_right = np.where(better, there, best), np.where(better[:, None, None], other, put_right)
    return model.observation.with_points(observations, torch.as_tensor(put_right))
