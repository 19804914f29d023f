"""A film of several cameras before a model: the sensor of its pixels, and where its noise begins.

The room of recordings knows cameras as numpy, that of models as torch; here they meet.
"""

from typing import Any

import numpy as np
import torch

from invdyn.models import PinholeCameras, Pixels
from invdyn.models.observation.pinhole import project
from invdyn.models.observation.pixels import MAX_NOISE, MIN_NOISE
from invdyn.recordings.cameras import Calibration, Filmed
from invdyn.recordings.cameras.projection import Lens

LEARNED = ("offset", "pose", "turn")
"""What may be learned of cameras: clocks and poses of all but the first, or how each of them is rotated."""


def pinhole(calibration: Calibration) -> PinholeCameras:
    """The cameras of a calibration, in float64."""
    cameras = list(calibration)

    def tensor(rows: list) -> torch.Tensor:
        return torch.tensor(np.stack(rows), dtype=torch.float64)

    fisheye = torch.tensor([camera.fisheye for camera in cameras])
    return PinholeCameras(
        focal=tensor([camera.focal for camera in cameras]),
        center=tensor([camera.center for camera in cameras]),
        distortion=tensor([np.pad(camera.distortion, (0, 5 - len(camera.distortion))) for camera in cameras]),
        rotation=tensor([camera.rotation for camera in cameras]),
        translation=tensor([camera.translation for camera in cameras]),
        limit=tensor([np.asarray(Lens.of(camera).limit) for camera in cameras]),
        fisheye=fisheye if bool(fisheye.any()) else None,
    )


def pixels_of(recording: Filmed, sites: list[tuple[int, int]], learn: tuple[str, ...] = ()) -> Pixels:
    """The sensor of a film's pixels.

    Args:
        recording: the film.
        sites: pairs (keypoint of the recording, site of the body).
        learn: what of the cameras is to be learned, among ``LEARNED``.
    """
    views = recording.views
    assert views is not None  # as it was made
    order = [keypoint for keypoint, _ in sites]
    # A picture of unknown size reaches twice as far as its middle.
    size = [camera.size or tuple(2 * camera.center) for camera in views.calibration]
    confidence = views.confidence[:, :, order]
    tells = np.isfinite(confidence).any() and np.ptp(confidence[np.isfinite(confidence)]) > 0
    return Pixels(
        cameras=pinhole(views.calibration),
        camera_names=views.calibration.names,
        size=torch.tensor(np.array(size, dtype=np.float64)),
        sites=tuple(site for _, site in sites),
        confidence=confidence if tells else None,
        resolution=_resolution(views.calibration, recording.keypoints[:, order]),
        timed="offset" in learn,
        posed="pose" in learn,
        rotation_uncertain="turn" in learn,
    )


def _resolution(calibration: Calibration, points: np.ndarray) -> float:
    """Metres that a pixel spans at the middle of points (T, P, 3), of a typical camera."""
    middle = np.nanmedian(points.reshape(-1, 3), axis=0)
    return float(np.median([np.linalg.norm(each.position - middle) / each.focal.mean() for each in calibration]))


def started(pixels: Pixels, rows: np.ndarray, points: np.ndarray) -> dict[str, Any]:
    """Noise and lasting errors as pixels (T, C P 2) are off rigid links, whose sites are at ``points`` (T, P, 3).

    Jitter is noise; what is more lasts.
    """
    expected, _ = project(pixels.cameras, torch.as_tensor(points))
    off = rows.reshape(len(rows), *pixels.shape) - expected.numpy()
    misfit = 1.4826 * np.nanmedian(np.where(np.isfinite(off), np.abs(off), np.nan), axis=0).max(-1)
    misfit = np.where(np.isfinite(misfit), misfit, np.nanmedian(misfit))
    return {"emission.bias_scale": np.clip(misfit, 10 * MIN_NOISE, MAX_NOISE)}
