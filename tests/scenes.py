"""Cameras around a scene, and pictures of a board as such a camera takes them."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.recordings.cameras.camera import Calibration, Camera
from invdyn.recordings.cameras.projection import rays

DISTORTION = (-0.12, 0.05, 0.001, -0.0006, 0.0)
SIZE = (1280, 960)


def looking(name, position, target=(0.0, 0.0, 1.0), focal=1100.0, distortion=DISTORTION, size=SIZE, fisheye=False):
    """A camera at a place that looks at another, level (z is up)."""
    position, target = np.asarray(position, float), np.asarray(target, float)
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = [[focal, 0, size[0] / 2 - 7], [0, 1.01 * focal, size[1] / 2 + 5], [0, 0, 1]]
    return Camera(name, matrix, distortion, rotation, -rotation @ position, size, fisheye)


def ring(count=4, radius=3.0, **options):
    """Cameras on most of a circle, at different heights, metric."""
    angle = np.linspace(0, 1.4 * np.pi, count)
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1.0 + 0.5 * np.cos(2 * np.arange(count))], -1)
    return Calibration(tuple(looking(f"cam{c + 1}", place, **options) for c, place in enumerate(places)), metric=True)


def swinging(frames=40):
    """Shoulder, elbow and wrist of an arm (.3 m, .25 m) that swings, (T, 3, 3) m."""
    time = np.linspace(0, 2, frames)
    first = np.stack([0.6 * np.sin(3 * time), 0.4 * np.cos(2 * time)], -1)
    second = first + np.stack([0.7 + 0.4 * np.sin(4 * time), 0.2 * np.sin(time)], -1)

    def along(angles):
        tilt, turn = angles.T
        return np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)], -1)

    shoulder = np.stack([0.1 * np.sin(time), 0.05 * time, 1.3 + 0.02 * np.cos(5 * time)], -1)
    elbow = shoulder + 0.3 * along(first)
    return np.stack([shoulder, elbow, elbow + 0.25 * along(second)], 1)


def moved(calibration, seed=0):
    """All cameras but the first pushed by some cm and turned by a degree."""
    rng = np.random.default_rng(seed)
    first, *others = calibration
    pushed = [
        replace(
            camera,
            rotation=Rotation.from_rotvec(rng.normal(0, 0.02, 3)).as_matrix() @ camera.rotation,
            translation=camera.translation + rng.normal(0, 0.03, 3),
        )
        for camera in others
    ]
    return Calibration((first, *pushed), calibration.metric)


@cache
def _finer_rays(camera, finer):
    """Rays through a camera's pixels, so many along each side of one: the same for all pictures."""
    width, height = camera.size
    offset = (np.arange(finer) + 0.5) / finer - 0.5
    column = (np.arange(width)[:, None] + offset).ravel()
    row = (np.arange(height)[:, None] + offset).ravel()
    return rays(camera, np.stack(np.meshgrid(column, row), -1))


def picture_of(camera, texture, millimetre, pose, finer=2):
    """Grey picture (H, W) of a flat board: each pixel is where its ray meets the board's plane.

    Args:
        camera: which takes it.
        texture: the board (h, w) uint8, white beyond it.
        millimetre: function of places (…, 2) on the board, m, to pixels (…, 2) of the texture.
        pose: rotation and place of the board in the scene.
        finer: rays along each side of a pixel.
    """
    import cv2

    width, height = camera.size
    aim = _finer_rays(camera, finer)
    rotation, place = pose
    normal = rotation[:, 2]
    reach = ((place - camera.position) @ normal) / (aim @ normal)
    local = (camera.position + reach[..., None] * aim - place) @ rotation
    at = np.where((reach > 0)[..., None], millimetre(local[..., :2]), -1e6).astype(np.float32)
    fine = cv2.remap(texture, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
    return np.rint(fine.reshape(height, finer, width, finer).mean((1, 3))).astype(np.uint8)
