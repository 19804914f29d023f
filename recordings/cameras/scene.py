"""From tracks of several cameras to a recording in space: triangulated, scaled to metres, z up.

A scene whose calibration is not metric is known up to one factor, which a stated length determines: the median
distance of two keypoints over the frames that show both, or the distance of two cameras.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..recording import Recording
from .bundle import bundle_adjust
from .camera import Calibration
from .exchanged_cameras import suspicion
from .reprojection import CameraErrors, reprojection
from .triangulate import triangulate
from .views import Views

UP = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "-y": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "-x": np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]),
}
"""Rotations (3, 3) that take the named axis to z."""


@dataclass(frozen=True)
class Length:
    """A distance that is known: of two keypoints, or of two cameras.

    Attributes:
        first, second: names.
        metres: positive.
    """

    first: str
    second: str
    metres: float

    @classmethod
    def parse(cls, text: str) -> "Length":
        """Read "shoulder:elbow=0.28". Raises InputError for anything else."""
        ends, equals, number = text.partition("=")
        first, colon, second = (word.strip() for word in ends.partition(":"))
        try:
            metres = float(number)
        except ValueError:
            metres = np.nan
        if not (equals and colon and first and second and first != second and np.isfinite(metres) and metres > 0):
            raise InputError(f"a length is FROM:TO=METRES, such as shoulder:elbow=0.28, got {text!r}")
        return cls(first, second, metres)


@dataclass(frozen=True)
class Scene:
    """The result.

    Attributes:
        recording: keypoints (T, P, 3) m, NaN where fewer than two cameras see a point; confidence as below.
        sd: (T, P, 3) m, standard deviations of x, y, z.
        calibration: the cameras in the recording's frame, metric.
        rows: reprojection errors.
        scale: σ of a pixel.
        factor: by which lengths were multiplied.

    A point's confidence is the mean over all cameras of a tracker's confidence times the weight its pixel got, at
    most 1; where a camera does not see it, 0 counts.
    """

    recording: Recording
    sd: np.ndarray
    calibration: Calibration
    rows: list[CameraErrors]
    scale: float
    factor: float


def reconstruct(
    views: Views,
    *,
    lengths: Sequence[Length] = (),
    baseline: Length | None = None,
    up: str = "z",
    refine: bool = False,
    intrinsics: Sequence[str] = (),
    scale: float | None = None,
    name: str = "recording",
) -> Scene:
    """Triangulate all frames of several films; warns where cameras seem to be exchanged, or not of one scene.

    Args:
        views: tracks and cameras.
        lengths: distances of keypoints; of several the factor is the geometric mean of theirs.
        baseline: distance of two cameras, instead.
        up: axis of the calibration's frame that points up; a key of `UP`.
        refine: adjust the cameras' poses to these tracks first.
        intrinsics: what of the lenses to adjust with them, see `bundle_adjust`.
        scale: σ of a pixel, px; default: estimated.
        name: of the recording.

    Raises:
        InputError: as `triangulate` and `bundle_adjust`; an axis or a name that is not known, two kinds of length, or
            none for a calibration that is not metric.
    """
    if up not in UP:
        raise InputError(f"up is one of {', '.join(UP)}, got {up!r}")
    if lengths and baseline:
        raise InputError(
            "the scale comes from the body's lengths or from the distance of two cameras: pass one kind, not both"
        )
    calibration = views.calibration
    if not (calibration.metric or lengths or baseline):
        raise InputError(
            "the calibration does not state the unit of its lengths: pass its unit (--set unit=mm), or a length "
            "between two keypoints (--length FROM:TO=METRES) or two cameras (--set baseline=FROM:TO=METRES)"
        )
    if intrinsics and not refine:
        raise InputError("lenses are adjusted together with poses only: choose both")
    pixels, confidence = views.flat()
    if refine:
        calibration = bundle_adjust(calibration, pixels, confidence, intrinsics).calibration
    found = triangulate(calibration, pixels, confidence, scale)
    residuals = views.unflat(found.residuals)
    if (doubt := suspicion(replace(views, calibration=calibration), residuals)) is not None:
        warnings.warn(f"{name}: {doubt}", stacklevel=2)
    points = views.unflat(found.points)
    factor = _factor(points, views.keypoint_names, calibration, lengths, baseline)
    rotation = UP[up]
    covariance = views.unflat(rotation @ found.covariance @ rotation.T) * factor**2
    trust = np.minimum(found.weights, 1.0) * np.nan_to_num(confidence)
    return Scene(
        recording=Recording(
            time=views.time,
            keypoints=factor * points @ rotation.T,
            keypoint_names=views.keypoint_names,
            confidence=views.unflat(trust.mean(1)),
            name=name,
        ),
        sd=np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)),
        calibration=replace(calibration.scaled(factor).rotated(rotation), error=None if refine else calibration.error),
        rows=reprojection(calibration.names, views.keypoint_names, residuals, views.unflat(found.weights)),
        scale=found.scale,
        factor=factor,
    )


def _factor(
    points: np.ndarray,
    names: Sequence[str],
    calibration: Calibration,
    lengths: Sequence[Length],
    baseline: Length | None,
) -> float:
    if baseline is not None:
        if (found := calibration.baseline(baseline.first, baseline.second)) <= 0:
            raise InputError(
                f"cameras {baseline.first} and {baseline.second} have the same position: state another distance"
            )
        return baseline.metres / found
    logs = []
    for length in lengths:
        for end in (length.first, length.second):
            if end not in names:
                raise InputError(f"no keypoint {end!r}: the tracks have {', '.join(names)}")
        ends = (points[:, names.index(end)] for end in (length.first, length.second))
        distance = np.linalg.norm(np.subtract(*ends), axis=-1)
        if not np.isfinite(distance).any():
            raise InputError(f"{length.first} and {length.second} are never both in space: state another length")
        logs.append(np.log(length.metres / np.nanmedian(distance)))
    return float(np.exp(np.mean(logs))) if logs else 1.0
