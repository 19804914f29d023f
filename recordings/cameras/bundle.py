"""Bundle adjustment: poses of the cameras, and at choice their lenses, together with the points that they see.

Maximises the likelihood of `triangulate`, Student-t with ν = 4 in the plane, over cameras and points at once: EM's
weights alternate with a few steps of SciPy's trust-region least squares on an exact, sparse Jacobian (Triggs et al.,
"Bundle adjustment: a modern synthesis", 2000). Pixels determine neither the first camera's pose nor the scale: both are
fixed, the scale by the distance from the first camera to the one farthest from it. By default lenses are fixed as well:
a few points of one body determine a focal length poorly. A careful calibration's poses are better than adjusted ones
where a tracker is wrong in one view for long, since the poses absorb such errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from ..errors import InputError
from .camera import Calibration, Camera
from .projection import project_with_jacobian
from .triangulate import DEGREES_OF_FREEDOM, UNSEEN, triangulate

INTRINSICS = ("focal", "distortion")
EVALUATIONS_PER_ROUND = 4
"""Evaluations of a least-squares problem before its weights are computed again."""
MIN_SHARED_POINTS = 8
"""Points that a camera must share with others. Its pose has six numbers, each point gives two."""


@dataclass(frozen=True)
class Adjusted:
    """What came out.

    Attributes:
        calibration: the cameras; metric where the ones given were.
        points: (N, 3), NaN where fewer than two cameras see one.
        before, after: median distance of pixel and projection, px.
        converged: the optimiser stopped by itself.
    """

    calibration: Calibration
    points: np.ndarray
    before: float
    after: float
    converged: bool


def bundle_adjust(
    calibration: Calibration,
    pixels: np.ndarray,
    confidence: np.ndarray | None = None,
    intrinsics: Sequence[str] = (),
    rounds: int = 100,
) -> Adjusted:
    """Adjust C cameras and N points.

    Args:
        calibration: the initial values.
        pixels: (N, C, 2), NaN where a camera does not see the point.
        confidence: (N, C), in [0, 1]; default 1.
        intrinsics: of `INTRINSICS`, what to estimate in addition to the poses: "focal", one factor a camera for fx and
            fy; "distortion", the first two radial coefficients of Brown's law.
        rounds: of weights and least squares, at most.

    Raises:
        InputError: as `triangulate`; an unknown name, a fisheye lens whose distortion is to be estimated, or a camera
            that shares too few points with the others.
    """
    if unknown := [name for name in intrinsics if name not in INTRINSICS]:
        raise InputError(f"unknown part of a lens {unknown[0]!r}: known are {', '.join(INTRINSICS)}")
    start = triangulate(calibration, pixels, confidence)
    known = np.isfinite(start.points).all(-1)
    trust = np.ones(pixels.shape[:2]) if confidence is None else np.clip(np.nan_to_num(confidence), 0, 1)
    used = np.isfinite(start.residuals).all(-1) & (trust > 0)
    for camera, count in zip(calibration, used.sum(0), strict=True):
        if count < MIN_SHARED_POINTS:
            raise InputError(
                f"camera {camera.name!r} shares {count} points with the others, expected {MIN_SHARED_POINTS} or "
                "more: leave it out"
            )
        if "distortion" in intrinsics and camera.fisheye:
            raise InputError(f"camera {camera.name!r} has a fisheye lens, whose distortion stays as it is")
    problem = BundleProblem(calibration, pixels[known], trust[known] * used[known], start.scale, tuple(intrinsics))
    vector, converged = problem.fit(problem.pack(start.points[known]), rounds)
    cameras, points = problem.unpack(vector)
    adjusted, factor = _rescaled(calibration, replace(calibration, cameras=tuple(cameras)))
    whole = np.full((len(pixels), 3), np.nan)
    origin = calibration.cameras[0].position
    whole[known] = origin + factor * (points - origin)

    def median(of: Sequence[Camera], at: np.ndarray) -> float:
        distance = [np.linalg.norm(pixels[:, c] - project_with_jacobian(k, at)[0], axis=-1) for c, k in enumerate(of)]
        return float(np.nanmedian(np.where(used, np.stack(distance, 1), np.nan)))

    return Adjusted(
        calibration=adjusted,
        points=whole,
        before=median(calibration.cameras, start.points),
        after=median(adjusted.cameras, whole),
        converged=converged,
    )


def _rescaled(before: Calibration, after: Calibration) -> tuple[Calibration, float]:
    """The scene scaled about the first camera until the first and the farthest are as far apart as they were."""
    origin = before.cameras[0].position
    distance = [np.linalg.norm(camera.position - origin) for camera in before]
    far = int(np.argmax(distance))
    factor = distance[far] / np.linalg.norm(after.cameras[far].position - origin)
    cameras = tuple(
        replace(camera, translation=-camera.rotation @ (origin + factor * (camera.position - origin)))
        for camera in after
    )
    return replace(after, cameras=cameras), float(factor)


@dataclass(frozen=True)
class BundleProblem:
    """Parameters in one vector: 6 a camera but the first (rotation vector, shift), then its lens's, then 3 a point."""

    calibration: Calibration
    pixels: np.ndarray
    trust: np.ndarray
    sigma: float
    intrinsics: tuple[str, ...]

    @property
    def lens_size(self) -> int:
        """Free numbers of a lens."""
        return ("focal" in self.intrinsics) + 2 * ("distortion" in self.intrinsics)

    @property
    def camera_size(self) -> int:
        """Parameters of all cameras."""
        return 6 * (len(self.calibration) - 1) + self.lens_size * len(self.calibration)

    def pack(self, points: np.ndarray) -> np.ndarray:
        """The initial vector: the cameras as given."""
        return np.concatenate([np.zeros(self.camera_size), points.ravel()])

    def unpack(self, vector: np.ndarray) -> tuple[list[Camera], np.ndarray]:
        """Cameras, and points (M, 3)."""
        return [self._camera(vector, c) for c in range(len(self.calibration))], vector[self.camera_size :].reshape(
            -1, 3
        )

    def _pose_at(self, c: int) -> slice:
        return slice(6 * (c - 1), 6 * c)

    def _lens_at(self, c: int) -> slice:
        first = 6 * (len(self.calibration) - 1) + self.lens_size * c
        return slice(first, first + self.lens_size)

    def _camera(self, vector: np.ndarray, c: int) -> Camera:
        camera = self.calibration.cameras[c]
        if c:
            turn, shift = np.split(vector[self._pose_at(c)], 2)
            rotation = Rotation.from_rotvec(turn).as_matrix() @ camera.rotation
            camera = replace(camera, rotation=rotation, translation=camera.translation + shift)
        lens = list(vector[self._lens_at(c)])
        if "focal" in self.intrinsics:
            matrix = camera.matrix.copy()
            matrix[[0, 1], [0, 1]] *= np.exp(lens.pop(0))
            camera = replace(camera, matrix=matrix)
        if "distortion" in self.intrinsics:
            camera = replace(camera, distortion=camera.distortion + np.array([*lens, 0, 0, 0]))
        return camera

    def fit(self, vector: np.ndarray, rounds: int) -> tuple[np.ndarray, bool]:
        """Weights and least squares in turn, until the cost stays; the last vector, and whether it did."""
        cost = np.inf
        for _ in range(rounds):
            square = (self.pixel_errors(vector) ** 2).sum(-1)
            before, cost = cost, 0.5 * (DEGREES_OF_FREEDOM + 2) * np.log1p(square / DEGREES_OF_FREEDOM).sum()
            if before - cost < 1e-7 * cost:
                return vector, True
            root = np.sqrt((DEGREES_OF_FREEDOM + 2) / (DEGREES_OF_FREEDOM + square))
            vector = least_squares(
                lambda v, root=root: (root[..., None] * self.pixel_errors(v)).ravel(),
                vector,
                jac=lambda v, root=root: self.jacobian(v, root),
                x_scale="jac",
                tr_solver="lsmr",
                tr_options={"atol": 1e-9, "btol": 1e-9, "maxiter": 500},
                max_nfev=EVALUATIONS_PER_ROUND,
            ).x
        return vector, False

    def pixel_errors(self, vector: np.ndarray) -> np.ndarray:
        """(C, M, 2) projection less pixel, in σ; 0 of a pixel that is not there."""
        cameras, points = self.unpack(vector)
        rows = []
        for c, camera in enumerate(cameras):
            miss = np.nan_to_num(project_with_jacobian(camera, points)[0] - self.pixels[:, c], nan=UNSEEN)
            rows.append(np.sqrt(self.trust[:, c, None]) * miss / self.sigma)
        return np.stack(rows)

    def jacobian(self, vector: np.ndarray, root_weight: np.ndarray) -> csr_matrix:
        """Of the weighted misses, by blocks: each pixel depends on one camera and one point."""
        cameras, points = self.unpack(vector)
        many = len(points)
        values, rows, columns = [], [], []

        def put(block: np.ndarray, row: np.ndarray, column: np.ndarray) -> None:
            values.append(block.ravel())
            rows.append(np.broadcast_to(row, block.shape).ravel())
            columns.append(np.broadcast_to(column, block.shape).ravel())

        for c, camera in enumerate(cameras):
            pixels, by_local, local = project_with_jacobian(camera, points)
            root = (root_weight[c] * np.sqrt(self.trust[:, c]))[:, None, None] / self.sigma
            by_local = np.nan_to_num(root * by_local)
            row = (2 * (c * many + np.arange(many))[:, None] + [0, 1])[:, :, None]
            at = self.camera_size + 3 * np.arange(many)[:, None] + [0, 1, 2]
            put(by_local @ camera.rotation, row, at[:, None])
            if c:
                turn = vector[self._pose_at(c)][:3]
                swung = -_cross(local - camera.translation) @ _left_jacobian(turn)
                put(np.concatenate([by_local @ swung, by_local], -1), row, np.arange(6 * (c - 1), 6 * c))
            if self.lens_size:
                block = np.nan_to_num(root * self._by_lens(camera, pixels, local))
                at_lens = self._lens_at(c)
                put(block, row, np.arange(at_lens.start, at_lens.stop))
        shape = (2 * many * len(cameras), len(vector))
        return csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape)

    def _by_lens(self, camera: Camera, pixels: np.ndarray, local: np.ndarray) -> np.ndarray:
        columns = []
        if "focal" in self.intrinsics:
            columns.append(pixels - camera.center)
        if "distortion" in self.intrinsics:
            plane = local[:, :2] / local[:, 2:]
            square = (plane**2).sum(-1, keepdims=True)
            columns += [camera.focal * plane * square, camera.focal * plane * square**2]
        return np.stack(columns, -1)


def _cross(vectors: np.ndarray) -> np.ndarray:
    """(…, 3) → (…, 3, 3), the matrices of v ×."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


def _left_jacobian(turn: np.ndarray) -> np.ndarray:
    """J(ω), the left Jacobian of a rotation vector: d exp(ω) v = −(exp(ω) v) × J(ω) dω."""
    angle = np.linalg.norm(turn)
    cross = _cross(turn)
    if angle < 1e-4:  # the series, whose next term is below rounding
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
