"""A camera's matrix and lens from pictures of a board, by OpenCV (extra `cameras`; Zhang, IEEE PAMI 22, 2000).

Of many pictures forty are kept that differ most in where and how large the board is. Brown's k1, k2, p1, p2 are fitted;
k3 is 0, because boards rarely reach the corners that would determine it. Pictures that leave the focal length open, as
those of a board that never tilts do, are refused. Pictures whose own error is many times the median are left out.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .boards import Board, opencv

MIN_PICTURES, MAX_PICTURES = 5, 40
MIN_PERSPECTIVE = 0.03
"""How much larger, as a fraction, the near edge of the most tilted board must look than its middle."""
MAX_FOCAL_SD = 0.03
"""Standard deviation of a focal length, as a fraction of it."""
MAX_ERROR_RATIO = 4.0
"""Over the median one; a picture with a larger error is left out."""


@dataclass(frozen=True)
class Intrinsics:
    """Result for one camera.

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
    if len(found) < MIN_PICTURES:
        raise InputError(
            f"camera {name!r}: the board was found in {len(found)} pictures, expected {MIN_PICTURES} or more: check "
            "its kind "
            "and size, or show it longer, whole and sharp"
        )
    if (perspective := max(_perspective(board, pixels) for pixels in found.values())) < MIN_PERSPECTIVE:
        raise InputError(
            f"camera {name!r}: the focal length cannot be determined, as the board's near edge looks "
            f"{perspective:.1%} larger "
            "than its middle at most: tilt the board by 30° and more, this way and that, near and far"
        )
    chosen = _diverse([found[number] for number in sorted(found)])
    fit = _fit(board, chosen, size)
    errors = np.ravel(fit[-1])
    kept = [
        pixels for pixels, error in zip(chosen, errors, strict=True) if error <= MAX_ERROR_RATIO * np.median(errors)
    ]
    if MIN_PICTURES <= len(kept) < len(chosen):
        fit = _fit(board, kept, size)
        chosen = kept
    error, matrix, distortion, deviations, _ = fit
    focal, focal_sd = matrix[[0, 1], [0, 1]], np.ravel(deviations)[:2]
    if not np.isfinite(focal_sd).all() or (focal_sd > MAX_FOCAL_SD * focal).any():
        raise InputError(
            f"camera {name!r}: its focal length is {focal[0]:.4g} ± {focal_sd[0]:.2g} px, too uncertain: tilt the "
            "board by "
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
        error, matrix, distortion, _, _, deviations, _, errors = cv2.calibrateCameraExtended(
            places, pixels, size, None, None, flags=cv2.CALIB_FIX_K3
        )
    except cv2.error as failure:
        raise InputError(f"OpenCV found no camera for these pictures ({failure.err})") from None
    return error, matrix, distortion, deviations, errors


def _diverse(pictures: list[np.ndarray]) -> list[np.ndarray]:
    """At most `MAX_PICTURES` pictures, each the farthest from those before in the board's place, size and slant."""
    if len(pictures) <= MAX_PICTURES:
        return pictures
    marks = []
    for pixels in pictures:
        seen = pixels[np.isfinite(pixels).all(-1)]
        marks.append([*seen.mean(0), *np.linalg.cholesky(np.cov(seen.T) + 1e-6 * np.eye(2))[[0, 1, 1], [0, 0, 1]]])
    marks = np.array(marks) / (np.std(marks, axis=0) + 1e-9)
    chosen = [0]
    distance = np.linalg.norm(marks - marks[0], axis=-1)
    while len(chosen) < MAX_PICTURES:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(marks - marks[chosen[-1]], axis=-1))
    return [pictures[number] for number in sorted(chosen)]
