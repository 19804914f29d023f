"""A camera's matrix and lens from pictures of a board, by OpenCV (extra `cameras`; Zhang, IEEE PAMI 22, 2000).

Of many pictures forty are kept that differ most in where and how large the board is. Brown's k1, k2, p1, p2 are fitted;
k3 is 0, because boards rarely reach the corners that would tell it. A focal length that the pictures leave open, as do
those of a board that never tilts, is refused. Pictures whose own error is many times the median are left out.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .boards import Board, opencv

FEWEST, MOST_PICTURES = 5, 40
LEAST_PERSPECTIVE = 0.03
"""Of the board that tilts most: how much larger its near edge looks than its middle."""
LOOSE = 0.03
"""Largest standard deviation of a focal length, of itself."""
STRAY = 4.0
"""Times the median error, at which a picture is left out."""


@dataclass(frozen=True)
class Intrinsics:
    """What one camera's pictures say.

    Attributes:
        matrix: (3, 3), px.
        distortion: (5,).
        size: width, height, px.
        error: RMS px.
        focal_sd: (2,) px, standard deviations of fx, fy.
        pictures: how many were used.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    size: tuple[int, int]
    error: float
    focal_sd: np.ndarray
    pictures: int


def fit_intrinsics(name: str, board: Board, found: dict[int, np.ndarray], size: tuple[int, int]) -> Intrinsics:
    """Fit a camera.

    Args:
        name: for messages.
        board: of the pictures.
        found: picture's number → pixels (n, 2) of the board's corners, NaN of those not seen.
        size: width, height, px.

    Raises InputError for fewer than five pictures with a board, or pictures that leave the focal length open.
    """
    if len(found) < FEWEST:
        raise InputError(
            f"camera {name!r}: the board was found in {len(found)} pictures, expected {FEWEST} or more: check its kind "
            "and size, or show it longer, whole and sharp"
        )
    if (perspective := max(_perspective(board, pixels) for pixels in found.values())) < LEAST_PERSPECTIVE:
        raise InputError(
            f"camera {name!r}: nothing tells the focal length, as the board's near edge looks {perspective:.1%} larger "
            "than its middle at most: tilt the board by 30° and more, this way and that, near and far"
        )
    chosen = _spread([found[number] for number in sorted(found)])
    fit = _fit(board, chosen, size)
    errors = np.ravel(fit[-1])
    kept = [pixels for pixels, error in zip(chosen, errors, strict=True) if error <= STRAY * np.median(errors)]
    if FEWEST <= len(kept) < len(chosen):
        fit = _fit(board, kept, size)
        chosen = kept
    error, matrix, distortion, spread, _ = fit
    focal, focal_sd = matrix[[0, 1], [0, 1]], np.ravel(spread)[:2]
    if not np.isfinite(focal_sd).all() or (focal_sd > LOOSE * focal).any():
        raise InputError(
            f"camera {name!r}: its focal length is {focal[0]:.4g} ± {focal_sd[0]:.2g} px, too loose: tilt the board by "
            "30° and more, this way and that, near and far"
        )
    return Intrinsics(matrix, np.ravel(distortion)[:5], size, float(error), focal_sd, len(chosen))


def _perspective(board: Board, pixels: np.ndarray) -> float:
    """Relative change of size from a board's middle to its edge, by the homography that takes one to the other."""
    seen = np.isfinite(pixels).all(-1)
    middle = board.corners.mean(0)
    places = (board.corners - middle)[:, :2] / np.abs(board.corners - middle)[:, :2].max(0)
    homography, _ = opencv().findHomography(places[seen], pixels[seen])
    return 0.0 if homography is None else float(np.abs(homography[2, :2]).sum() / np.abs(homography[2, 2]))


def _fit(board: Board, pictures: list[np.ndarray], size: tuple[int, int]) -> tuple:
    """RMS error, matrix, distortion, standard deviations, error of each picture."""
    cv2 = opencv()
    seen = [np.isfinite(pixels).all(-1) for pixels in pictures]
    places = [board.corners[each].astype(np.float32) for each in seen]
    pixels = [each[mask].astype(np.float32) for each, mask in zip(pictures, seen, strict=True)]
    try:
        error, matrix, distortion, _, _, spread, _, errors = cv2.calibrateCameraExtended(
            places, pixels, size, None, None, flags=cv2.CALIB_FIX_K3
        )
    except cv2.error as failure:
        raise InputError(f"OpenCV found no camera for these pictures ({failure.err})") from None
    return error, matrix, distortion, spread, errors


def _spread(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """At most `MOST_PICTURES` pictures, each the farthest from those before in the board's place, size and slant."""
    if len(pictures) <= MOST_PICTURES:
        return pictures
    marks = []
    for pixels in pictures:
        seen = pixels[np.isfinite(pixels).all(-1)]
        marks.append([*seen.mean(0), *np.linalg.cholesky(np.cov(seen.T) + 1e-6 * np.eye(2))[[0, 1, 1], [0, 0, 1]]])
    marks = np.array(marks) / (np.std(marks, axis=0) + 1e-9)
    chosen = [0]
    distance = np.linalg.norm(marks - marks[0], axis=-1)
    while len(chosen) < MOST_PICTURES:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(marks - marks[chosen[-1]], axis=-1))
    return [pictures[number] for number in sorted(chosen)]
