"""Bundle adjustment: poses of the cameras, and if asked their lenses, together with the points that they see.

Minimises Σ ρ(√w (y − π_c(R_c X + t_c)) / σ) over all pixels by SciPy's trust-region least squares with a sparse, exact
Jacobian (Triggs et al., "Bundle adjustment: a modern synthesis", 2000); ρ is the negative log of a Student-t with ν = 4
for each coordinate. What no pixel can tell is held: the first camera's pose, and the scale, by the distance from the
first camera to the one farthest from it. Lenses stay as they are unless asked for: few points of one body say little of
a focal length, and a fit that may move it moves it far.
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
from .triangulate import FAR, FREEDOM, triangulate

INTRINSICS = ("focal", "distortion")
FEWEST = 8
"""Points that a camera must share with others: six numbers of its pose, and some to spare."""


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
    most_evaluations: int = 200,
) -> Adjusted:
    """Adjust C cameras and N points.

    Args:
        calibration: where to begin.
        pixels: (N, C, 2), NaN where a camera does not see the point.
        confidence: (N, C), in [0, 1]; default 1.
        intrinsics: of `INTRINSICS`, what to free beside the poses: "focal", one factor a camera for fx and fy;
            "distortion", the first two radial coefficients of Brown's law.
        most_evaluations: of the residuals.

    Raises:
        InputError: as `triangulate`; an unknown name, a fisheye lens whose distortion is to be freed, or a camera that
            shares too few points with the others.
    """
    if unknown := [name for name in intrinsics if name not in INTRINSICS]:
        raise InputError(f"unknown part of a lens {unknown[0]!r}: known are {', '.join(INTRINSICS)}")
    start = triangulate(calibration, pixels, confidence)
    known = np.isfinite(start.points).all(-1)
    trust = np.ones(pixels.shape[:2]) if confidence is None else np.clip(np.nan_to_num(confidence), 0, 1)
    used = np.isfinite(start.residuals).all(-1) & (trust > 0)
    for camera, count in zip(calibration, used.sum(0), strict=True):
        if count < FEWEST:
            raise InputError(
                f"camera {camera.name!r} shares {count} points with the others, expected {FEWEST} or more: leave it out"
            )
        if "distortion" in intrinsics and camera.fisheye:
            raise InputError(f"camera {camera.name!r} has a fisheye lens, whose distortion stays as it is")
    problem = _Bundle(calibration, pixels[known], trust[known] * used[known], start.scale, tuple(intrinsics))
    found = least_squares(
        problem.residuals,
        problem.pack(start.points[known]),
        jac=problem.jacobian,
        loss=_student,
        x_scale="jac",
        tr_solver="lsmr",
        ftol=1e-10,
        xtol=1e-10,
        gtol=1e-10,
        max_nfev=most_evaluations,
    )
    cameras, points = problem.unpack(found.x)
    adjusted, factor = _held_scale(calibration, replace(calibration, cameras=tuple(cameras)))
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
        converged=bool(found.status > 0),
    )


def _student(square: np.ndarray) -> np.ndarray:
    """ρ, ρ′, ρ″ of squared residuals, as SciPy asks for them."""
    inner = 1 + square / FREEDOM
    slope = (FREEDOM + 1) / FREEDOM / inner
    return np.stack([(FREEDOM + 1) * np.log(inner), slope, -slope / (FREEDOM * inner)])


def _held_scale(before: Calibration, after: Calibration) -> tuple[Calibration, float]:
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
class _Bundle:
    """Parameters in one vector: 6 a camera but the first (turn, shift), then its lens's, then 3 a point."""

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
        """Where to begin: the cameras as given."""
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

    def residuals(self, vector: np.ndarray) -> np.ndarray:
        """Of all pixels, in σ; those of pixels that are not there are 0."""
        cameras, points = self.unpack(vector)
        rows = []
        for c, camera in enumerate(cameras):
            miss = np.nan_to_num(project_with_jacobian(camera, points)[0] - self.pixels[:, c], nan=FAR)
            rows.append(np.sqrt(self.trust[:, c, None]) * miss / self.sigma)
        return np.concatenate(rows).ravel()

    def jacobian(self, vector: np.ndarray) -> csr_matrix:
        """Of `residuals`, by blocks: each pixel depends on one camera and one point."""
        cameras, points = self.unpack(vector)
        many = len(points)
        values, rows, columns = [], [], []

        def put(block: np.ndarray, row: np.ndarray, column: np.ndarray) -> None:
            values.append(block.ravel())
            rows.append(np.broadcast_to(row, block.shape).ravel())
            columns.append(np.broadcast_to(column, block.shape).ravel())

        for c, camera in enumerate(cameras):
            pixels, by_local, local = project_with_jacobian(camera, points)
            root = np.sqrt(self.trust[:, c])[:, None, None] / self.sigma
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
    """How exp of a rotation vector turns with it: d exp(ω) v = −(exp(ω) v) × J(ω) dω."""
    angle = np.linalg.norm(turn)
    cross = _cross(turn)
    if angle < 1e-4:  # the series, whose next term is below rounding
        return np.eye(3) + cross / 2 + cross @ cross / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
