"""How well points in space explain the pixels: a row for each camera and keypoint.

A row has the median and the 90 % quantile of the distances |y − π(X)|, px. It has the median of the differences
y − π(X) across (u) and down (v) the picture: a tracker's constant offset in that view. It also has the share of
outliers, whose weight is below a third of the average pixel's.
"""

import csv
import io
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

OUTLIER_WEIGHT = 1 / 3  # of a pixel's weight over the mean


@dataclass(frozen=True)
class CameraErrors:
    """One camera and keypoint; px."""

    camera: str
    keypoint: str
    pixels: int
    median: float
    q90: float
    u: float
    v: float
    outliers: float


def reprojection(
    cameras: Sequence[str], keypoints: Sequence[str], residuals: np.ndarray, weights: np.ndarray
) -> list[CameraErrors]:
    """Rows for all, keypoints of one camera together, `all` last.

    Args:
        cameras, keypoints: C and P names.
        residuals: (T, P, C, 2) px, NaN where there is no pixel or no point.
        weights: (T, P, C) τ, as `Triangulated.weights`.
    """
    rows = []
    for c, camera in enumerate(cameras):
        for p, keypoint in enumerate(keypoints):
            rows.append(_row(camera, keypoint, residuals[:, p, c], weights[:, p, c]))
        rows.append(_row(camera, "all", residuals[:, :, c].reshape(-1, 2), weights[:, :, c].ravel()))
    return rows


def _row(camera: str, keypoint: str, residuals: np.ndarray, weights: np.ndarray) -> CameraErrors:
    seen = np.isfinite(residuals).all(-1)
    if not seen.any():
        return CameraErrors(camera, keypoint, 0, *[float("nan")] * 5)
    error = residuals[seen]
    distance = np.linalg.norm(error, axis=-1)
    u, v = np.median(error, axis=0)
    outliers = (weights[seen] < OUTLIER_WEIGHT).mean()
    numbers = (np.median(distance), np.quantile(distance, 0.9), u, v, outliers)
    return CameraErrors(camera, keypoint, int(seen.sum()), *map(float, numbers))


def table(rows: Sequence[CameraErrors]) -> str:
    """Rows as text for people."""
    head = f"{'camera':<14} {'keypoint':<16} {'pixels':>7} {'median':>7} {'90 %':>7} {'u':>7} {'v':>7} {'outliers':>9}"
    lines = [
        f"{row.camera:<14} {row.keypoint:<16} {row.pixels:>7} {row.median:>7.2f} {row.q90:>7.2f} {row.u:>7.2f} "
        f"{row.v:>7.2f} {row.outliers:>9.1%}"
        for row in rows
    ]
    return "\n".join([head, *lines])


def csv_text(rows: Sequence[CameraErrors]) -> str:
    """Rows as CSV, an unknown number as an empty cell."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(field.name for field in fields(CameraErrors))
    writer.writerows(["" if value != value else value for value in astuple(row)] for row in rows)
    return file.getvalue()
