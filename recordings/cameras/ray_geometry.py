"""Rays of several cameras to N points: the points nearest to them, and the angles between them.

Shapes: origins (C, 3), directions aim (N, C, 3) of length 1, trust (N, C), 0 where a camera does not see the point.
"""

from itertools import combinations

import numpy as np

from .camera import Calibration


def nearest(origins: np.ndarray, aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Points (N, 3) nearest to rays from origins (C, 3) along aim (N, C, 3): least squares of the distances."""
    projector = np.where(trust > 0, trust, 0)[..., None, None] * (np.eye(3) - aim[..., :, None] * aim[..., None, :])
    projector = np.nan_to_num(projector)
    normal = projector.sum(1) + 1e-12 * np.eye(3)
    return np.linalg.solve(normal, (projector @ origins[None, :, :, None]).sum(1))[..., 0]


def start_points(calibration: Calibration, aim: np.ndarray, trust: np.ndarray) -> list[np.ndarray]:
    """The point nearest to all rays, then those of each pair of cameras where there are more than two."""
    origins = np.stack([camera.position for camera in calibration])
    points = [nearest(origins, aim, trust)]
    if len(calibration) > 2:
        for pair in combinations(range(len(calibration)), 2):
            both = np.all(trust[:, pair] > 0, axis=1, keepdims=True)
            point = nearest(origins[list(pair)], aim[:, pair], trust[:, pair])
            points.append(np.where(both, point, points[0]))
    return points


def widest_angle(aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """(N,) rad, at most π/2, between the two rays that differ most: cameras that face each other determine no depth."""
    aim = np.where((trust > 0)[..., None], aim, np.nan)
    cross = np.linalg.norm(np.cross(aim[:, :, None], aim[:, None]), axis=-1)
    angle = np.arctan2(cross, np.abs((aim[:, :, None] * aim[:, None]).sum(-1)))
    return np.nanmax(angle, axis=(1, 2))
