"""Rays of several cameras to N points: where they nearly meet, and how far their directions differ.

Shapes: origins (C, 3), directions aim (N, C, 3) of length 1, trust (N, C), 0 where a camera does not see the point.
"""

from itertools import combinations

import numpy as np

from .camera import Calibration


def nearest(origins: np.ndarray, aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Points (N, 3) nearest to rays from origins (C, 3) along aim (N, C, 3): least squares of the distances."""
    across = np.where(trust > 0, trust, 0)[..., None, None] * (np.eye(3) - aim[..., :, None] * aim[..., None, :])
    across = np.nan_to_num(across)
    normal = across.sum(1) + 1e-12 * np.eye(3)
    return np.linalg.solve(normal, (across @ origins[None, :, :, None]).sum(1))[..., 0]


def starts(calibration: Calibration, aim: np.ndarray, trust: np.ndarray) -> list[np.ndarray]:
    """The point nearest to all rays, then those of each pair of cameras where there are more than two."""
    origins = np.stack([camera.position for camera in calibration])
    starts = [nearest(origins, aim, trust)]
    if len(calibration) > 2:
        for pair in combinations(range(len(calibration)), 2):
            both = np.all(trust[:, pair] > 0, axis=1, keepdims=True)
            point = nearest(origins[list(pair)], aim[:, pair], trust[:, pair])
            starts.append(np.where(both, point, starts[0]))
    return starts


def widest_angle(aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """(N,) rad, at most π/2, between the two lines of sight that differ most: cameras face to face tell no depth."""
    aim = np.where((trust > 0)[..., None], aim, np.nan)
    cross = np.linalg.norm(np.cross(aim[:, :, None], aim[:, None]), axis=-1)
    angle = np.arctan2(cross, np.abs((aim[:, :, None] * aim[:, None]).sum(-1)))
    return np.nanmax(angle, axis=(1, 2))
