"""Labels that a tracker has exchanged, put right where the links' lengths say so.

A rigid link's ends are its length L apart. Let r = max |‖p_i − p_{i−1}‖ − L_i| over the links whose ends are tracked;
the first link's inner end is the base. A row is put right where r is far above what it is in most rows, and is not once
the labels of two keypoints are exchanged. What is left of it is for :mod:`.outliers`. It only serves to find a first
path: how often labels are exchanged, an effect says, from the detections as they are.

Shapes: T rows, P keypoints, O observations.
"""

from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArmModel


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
