"""Left and right exchanged in tracks of several cameras (:mod:`..sides`). Shapes: T rows, C cameras."""

import warnings
from dataclasses import replace

import numpy as np

from ..sides import exchanged, pairs_of, partners
from .views import Views


def sides_kept(views: Views) -> tuple[Views, np.ndarray]:
    """Tracks whose left and right are consistent, and the rows (T, C) in which they were exchanged.

    Cameras are independent; keypoints without a counterpart in the names stay as they are.
    """
    pairs = pairs_of(views.keypoint_names)
    exchanges = np.stack([exchanged(views.pixels[:, c], pairs) for c in range(len(views.calibration))], 1)
    order = partners(views.keypoint_names)
    pixels = np.where(exchanges[..., None, None], views.pixels[:, :, order], views.pixels)
    confidence = np.where(exchanges[..., None], views.confidence[:, :, order], views.confidence)
    return replace(views, pixels=pixels, confidence=confidence), exchanges


def put_in_order(views: Views) -> Views:
    """Tracks whose left and right are consistent; a UserWarning counts the corrected rows of each camera."""
    kept, exchanges = sides_kept(views)
    for name, rows in zip(views.calibration.names, exchanges.T, strict=True):
        if rows.any():
            warnings.warn(
                f"camera {name}: left and right are exchanged in {rows.sum()} of {len(rows)} rows; they were put back",
                UserWarning,
                stacklevel=3,
            )
    return kept
