"""Where several cameras stand, from pictures of one board that they took at the same moments.

OpenCV's `solvePnP` gives the board's pose in each picture. Two cameras that see it together have the relative pose
R₂ R₁ᵀ, t₂ − R₂ R₁ᵀ t₁; of all their moments the one that agrees best with the others counts. A tree of such pairs
connects every camera to the first. Then all poses, of cameras and of boards, are fitted to all corners at once, lenses
fixed, with a loss that a mistaken board hardly changes (Cauchy's, of 1 px). The scene's frame is the first camera's: x
right, y down, z ahead.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix
from scipy.spatial.transform import Rotation

from ..errors import InputError
from .boards import Board, opencv
from .camera import Calibration, Camera
from .intrinsics import Intrinsics
from .projection import project

MIN_MOMENTS, MAX_MOMENTS = 3, 60
"""Moments that two cameras must share, and how many the joint fit uses."""
Pose = tuple[np.ndarray, np.ndarray]
"""Rotation (3, 3) and translation (3,)."""


def fit_rig(board: Board, lenses: dict[str, Intrinsics], found: dict[str, dict[int, np.ndarray]]) -> Calibration:
    """Poses of all cameras.

    Args:
        board: of the pictures.
        lenses: camera → what `fit_intrinsics` found; the first is the frame.
        found: camera → moment → pixels (n, 2) of the corners, NaN of those not seen.

    Raises InputError when a camera never sees the board together with another one that is connected to the first, or
    the board looks the same when it is rotated.
    """
    names = list(lenses)
    if len(names) > 1 and not board.is_unambiguous:
        raise InputError(
            f"a checkerboard of {board.columns} × {board.rows} corners looks the same rotated by half a revolution, "
            "so cameras confuse "
            "its corners: take one with an odd and an even side, or a ChArUco board"
        )
    cameras = {name: _camera(name, lens, (np.eye(3), np.zeros(3))) for name, lens in lenses.items()}
    boards = {name: {at: _board_pose(board, cameras[name], found[name][at]) for at in found[name]} for name in names}
    poses = _tree(names, boards)
    placed = [_camera(name, lenses[name], poses[name]) for name in names]
    moments = sorted({at for name in names for at in found[name]}, key=lambda at: -sum(at in found[n] for n in names))
    moments = sorted(moments[:MAX_MOMENTS])
    corners = np.full((len(names), len(moments), len(board.corners), 2), np.nan)
    for c, name in enumerate(names):
        for m, at in enumerate(moments):
            if at in found[name]:
                corners[c, m] = found[name][at]
    starts = [_board_in_scene(at, boards, poses) for at in moments]
    refined, error = _refine(board, placed, starts, corners)
    return Calibration(tuple(refined), metric=True, error=error)


def _camera(name: str, lens: Intrinsics, pose: Pose) -> Camera:
    return Camera(name, lens.matrix, lens.distortion, *pose, size=lens.size)


def _board_pose(board: Board, camera: Camera, pixels: np.ndarray) -> Pose:
    """Board to camera."""
    seen = np.isfinite(pixels).all(-1)
    _, rotation, shift = opencv().solvePnP(board.corners[seen], pixels[seen], camera.matrix, camera.distortion)
    return Rotation.from_rotvec(np.ravel(rotation)).as_matrix(), np.ravel(shift)


def _between(first: Pose, second: Pose) -> Pose:
    """From the frame of one camera to another's, by the board's pose in both."""
    rotation = second[0] @ first[0].T
    return rotation, second[1] - rotation @ first[1]


def _tree(names: list[str], boards: dict[str, dict[int, Pose]]) -> dict[str, Pose]:
    """Scene to camera for all: each is connected to the camera it shares most moments with (Prim's spanning tree)."""
    poses = {names[0]: (np.eye(3), np.zeros(3))}
    while len(poses) < len(names):
        links = [
            (len(set(boards[one]) & set(boards[other])), one, other)
            for one in poses
            for other in names
            if other not in poses
        ]
        many, one, other = max(links, key=lambda link: link[0])
        if many < MIN_MOMENTS:
            raise InputError(
                f"camera {other!r} sees the board together with {one!r} at {many} moments, expected {MIN_MOMENTS} or "
                "more: "
                "show it where both look, in films that start together"
            )
        shared = sorted(set(boards[one]) & set(boards[other]))
        rotation, shift = _typical([_between(boards[one][at], boards[other][at]) for at in shared])
        poses[other] = (rotation @ poses[one][0], rotation @ poses[one][1] + shift)
    return poses


def _typical(poses: list[Pose]) -> Pose:
    """The one that is nearest to all others: half of them may be wrong."""
    rotations = Rotation.from_matrix([rotation for rotation, _ in poses])
    shifts = np.stack([shift for _, shift in poses])
    reach = np.median(np.linalg.norm(shifts, axis=-1)) + 1e-9
    apart = [
        np.sum((rotation.inv() * rotations).magnitude() + np.linalg.norm(shifts - shift, axis=-1) / reach)
        for rotation, shift in zip(rotations, shifts, strict=True)
    ]
    return poses[int(np.argmin(apart))]


def _board_in_scene(at: int, boards: dict[str, dict[int, Pose]], poses: dict[str, Pose]) -> Pose:
    """Board to scene, by the first camera that sees it."""
    name = next(name for name in poses if at in boards[name])
    (rotation, shift), (camera_rotation, camera_shift) = boards[name][at], poses[name]
    return camera_rotation.T @ rotation, camera_rotation.T @ (shift - camera_shift)


def _refine(board: Board, cameras: list[Camera], starts: list[Pose], corners: np.ndarray) -> tuple[list[Camera], float]:
    """Cameras (the first stays) and boards fitted to corners (C, M, n, 2); also the error left, RMS px."""
    seen = np.isfinite(corners).all(-1)
    first = 6 * (len(cameras) - 1)

    def cameras_of(vector: np.ndarray) -> list[Camera]:
        moved = [cameras[0]]
        for camera, part in zip(cameras[1:], vector[:first].reshape(-1, 6), strict=True):
            rotation = Rotation.from_rotvec(part[:3]).as_matrix()
            moved.append(
                replace(camera, rotation=rotation @ camera.rotation, translation=camera.translation + part[3:])
            )
        return moved

    def errors(vector: np.ndarray) -> np.ndarray:
        parts = vector[first:].reshape(-1, 6)
        rotations = Rotation.from_rotvec(parts[:, :3]).as_matrix() @ np.stack([rotation for rotation, _ in starts])
        shifts = np.stack([shift for _, shift in starts]) + parts[:, 3:]
        points = board.corners @ rotations.swapaxes(1, 2) + shifts[:, None]
        rows = [
            np.nan_to_num(project(camera, points)[mask] - pixels[mask], nan=1e3)
            for camera, pixels, mask in zip(cameras_of(vector), corners, seen, strict=True)
        ]
        return np.concatenate(rows).ravel()

    vector = np.zeros(first + 6 * len(starts))
    pattern = lil_matrix((2 * int(seen.sum()), len(vector)), dtype=np.int8)
    camera, moment, _ = np.nonzero(seen)
    for row, (c, m) in enumerate(zip(camera, moment, strict=True)):
        pattern[2 * row : 2 * row + 2, first + 6 * m : first + 6 * m + 6] = 1
        if c:
            pattern[2 * row : 2 * row + 2, 6 * (c - 1) : 6 * c] = 1
    fit = least_squares(errors, vector, jac_sparsity=pattern, x_scale="jac", loss="cauchy", f_scale=1.0, max_nfev=50)
    error = np.sqrt(2 * np.mean(errors(fit.x) ** 2))
    return cameras_of(fit.x), float(error)
