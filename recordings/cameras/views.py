"""One scene in several films: the tracks of each camera, brought to the same times.

Pixels as a tracker writes them, y down the picture. Films whose time stamps agree are taken row by row. An offset is
by how much a camera's stamps run ahead of the first one's at the same moment, s; its tracks are then interpolated,
linearly and never across a gap. Left and right that a tracker has
exchanged are put back, camera by camera (:mod:`..sides`).

Shapes: T rows, C cameras, P keypoints.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..limits import PLAUSIBLE
from ..loader import read_file
from ..recording import Recording
from ..sides import exchanged, pairs_of, partners
from .camera import Calibration, Camera
from .projection import undistort


@dataclass(frozen=True, eq=False)
class Views:
    """T frames, C cameras, P keypoints.

    Attributes:
        calibration: C cameras, in the tracks' order.
        time: (T,) s, the first camera's.
        pixels: (T, C, P, 2), NaN where not seen.
        confidence: (T, C, P) in [0, 1]; 1 where a tracker gives none.
        keypoint_names: P.
    """

    calibration: Calibration
    time: np.ndarray
    pixels: np.ndarray
    confidence: np.ndarray
    keypoint_names: tuple[str, ...]

    def flat(self) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (T·P, C, 2) and confidences (T·P, C), for `triangulate` and `bundle_adjust`."""
        cameras = len(self.calibration)
        pixels = self.pixels.swapaxes(1, 2).reshape(-1, cameras, 2)
        return pixels, self.confidence.swapaxes(1, 2).reshape(-1, cameras)

    def at(self, frames: slice | np.ndarray) -> "Views":
        """Some frames, a slice or a mask (T,); times stay."""
        return replace(self, time=self.time[frames], pixels=self.pixels[frames], confidence=self.confidence[frames])

    def select(self, names: Sequence[str]) -> "Views":
        """The named keypoints, in that order."""
        order = [self.keypoint_names.index(name) for name in names]
        pixels, confidence = self.pixels[:, :, order], self.confidence[:, :, order]
        return replace(self, pixels=pixels, confidence=confidence, keypoint_names=tuple(names))

    def unflat(self, values: np.ndarray) -> np.ndarray:
        """(T·P, …) → (T, P, …)."""
        return values.reshape(len(self.time), len(self.keypoint_names), *values.shape[1:])


def match_names(files: list[str], names: tuple[str, ...]) -> dict[str, Path]:
    """Which camera each file is of: CAMERA=FILE, or a file whose name has one camera's as a whole word.

    arm_cam1.csv is of cam1, arm_cam12.csv is not: letters and digits continue a word, anything else ends it.

    Raises InputError for a name that no camera has, a file without any, or a camera with two files.
    """
    found: dict[str, Path] = {}
    for given in files:
        name, equals, path = given.partition("=")
        if not equals or name not in names:
            stem = Path(given).stem
            fitting = [each for each in names if stem == each] or [each for each in names if _is_word(each, stem)]
            if equals and not Path(given).exists():
                raise InputError(f"no camera {name!r} in the calibration: it has {', '.join(names)}")
            if len(fitting) != 1:
                raise InputError(
                    f"{given}: which camera is it of? The calibration has {', '.join(names)}: write CAMERA=FILE"
                )
            name, path = fitting[0], given
        if name in found:
            raise InputError(f"camera {name!r} has two files, {found[name]} and {path}: expected one a camera")
        found[name] = Path(path)
    return found


def _is_word(name: str, text: str) -> bool:
    return re.search(rf"(?<![^\W_]){re.escape(name)}(?![^\W_])", text) is not None


def read_tracks(
    files: Mapping[str, Path],
    calibration: Calibration,
    *,
    fps: float | None = None,
    format: str | None = None,
    individual: str | None = None,
) -> dict[str, Recording]:
    """Read one file of tracks a camera, in pixels, y down.

    Args:
        files: camera → file, two or more; cameras of the calibration without a file are left out.
        calibration: the cameras.
        fps, format, individual: as `recordings.load`.

    Raises:
        InputError: fewer than two cameras, names that are not the same in all files, tracks in metres, outside the
            picture or where the lens's law has no ray, or likelihoods outside 0 to 1.
        OSError: a file that cannot be opened.
    """
    if len(files) < 2:
        raise InputError(f"expected tracks of two cameras or more, got {len(files)}: one picture shows no depth")
    tracks = {}
    for camera, path in zip(calibration.select(list(files)), files.values(), strict=True):
        recording = read_file(path, units="px", fps=fps, format=format, individual=individual)
        tracks[camera.name] = recording = replace(recording, keypoints=recording.keypoints * [1.0, -1.0])
        with about(path):
            _check_pixels(recording, camera)
    first = next(iter(tracks.values()))
    for name, track in tracks.items():
        if set(track.keypoint_names) != set(first.keypoint_names):
            odd = sorted(set(track.keypoint_names) ^ set(first.keypoint_names))[0]
            raise InputError(
                f"keypoint {odd!r} is not in the tracks of both {first.name!r} and {name!r}: expected the same names "
                "in all; a column may be empty"
            )
    return tracks


def at_one_time(
    tracks: Mapping[str, Recording], calibration: Calibration, offsets: Mapping[str, float] | None = None
) -> Views:
    """Tracks of all cameras at the first one's times.

    Args:
        tracks: camera → its tracks.
        calibration: the cameras.
        offsets: camera → s, see above; a camera that is named is interpolated, the others must agree row by row.

    Raises InputError for times that do not agree, or an offset of no camera.
    """
    offsets = dict(offsets or {})
    for name in offsets:
        if name not in tracks:
            raise InputError(f"an offset of camera {name!r}, which has no tracks: these have {', '.join(tracks)}")
    first = next(iter(tracks.values()))
    rows = [_at(track, first, name, offsets) for name, track in tracks.items()]
    return Views(
        calibration=calibration.select(list(tracks)),
        time=first.time,
        pixels=np.stack([pixels for pixels, _ in rows], 1),
        confidence=np.stack([confidence for _, confidence in rows], 1),
        keypoint_names=first.keypoint_names,
    )


def _check_pixels(recording: Recording, camera: Camera) -> None:
    if recording.confidence is not None and ((recording.confidence > 1) | (recording.confidence < 0)).any():
        raise InputError("the likelihoods are not between 0 and 1: expected those of a tracker")
    points = recording.keypoints[np.isfinite(recording.keypoints).all(-1)]
    if len(points) and np.abs(points).max() < PLAUSIBLE.pixel_extent:
        raise InputError(f"tracks of at most {np.abs(points).max():.3g} px: these look like metres; expected pixels")
    if camera.size is not None:
        outside = ((points < 0) | (points > camera.size)).any(-1).mean()
        if outside > 0.5:
            raise InputError(
                f"{outside:.0%} of the tracks lie outside the {camera.size[0]} × {camera.size[1]} px of camera "
                f"{camera.name!r}: is the film of another size than the calibration, or the other way up?"
            )
    without_ray = ~np.isfinite(undistort(camera, points)).all(-1)
    if without_ray.mean() > 0.5:
        raise InputError(
            f"{without_ray.mean():.0%} of the tracks lie where the lens of camera {camera.name!r} has no ray: its "
            "distortion "
            "folds the picture over there; calibrate with boards up to the edges, or fewer coefficients"
        )


def _at(track: Recording, first: Recording, name: str, offsets: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (T, P, 2) and confidences (T, P) of a camera at the first one's times, in its order of keypoints."""
    order = [track.keypoint_names.index(point) for point in first.keypoint_names]
    pixels = track.keypoints[:, order]
    confidence = np.ones(pixels.shape[:2]) if track.confidence is None else track.confidence[:, order]
    if name not in offsets:
        _check_times(track, first, name)
        return pixels, confidence
    return _interpolated(track.time - offsets[name], pixels, confidence, first.time, 1.5 * track.frame_interval)


def _check_times(track: Recording, first: Recording, name: str) -> None:
    fix = f"cut the films to the same frames, or state by how much its stamps run ahead: --set offset={name}=SECONDS"
    if track.num_frames != first.num_frames:
        raise InputError(f"camera {name!r} has {track.num_frames} rows, the first camera {first.num_frames}: {fix}")
    apart = track.time - first.time
    worst = apart[np.abs(apart).argmax()]
    if abs(worst) > PLAUSIBLE.stamp_difference * first.frame_interval:
        raise InputError(f"times of camera {name!r} are {worst:+.4g} s off those of the first camera: {fix}")


def _interpolated(
    time: np.ndarray, pixels: np.ndarray, confidence: np.ndarray, at: np.ndarray, gap: float
) -> tuple[np.ndarray, np.ndarray]:
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    before = after - 1
    share = (at - time[before]) / (time[after] - time[before])
    share = np.where(np.abs(share - np.rint(share)) < 1e-9, np.rint(share), share)
    # A time that equals a stamp needs no second neighbour.
    inside = (share == 0) | (share == 1) | ((share > 0) & (share < 1) & (time[after] - time[before] <= gap))
    share = np.where(inside, share, np.nan)[:, None, None]
    low = np.where(share == 1, 0.0, (1 - share) * pixels[before])
    high = np.where(share == 0, 0.0, share * pixels[after])
    return low + high, np.minimum(confidence[before], confidence[after])


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
