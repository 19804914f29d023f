"""Scene to pixels and back, with derivatives: the pinhole camera with Brown's or a fisheye lens's distortion.

    x = R X + t,   (a, b) = (x, y) / z,   r² = a² + b²
    Brown     d = 1 + k1 r² + k2 r⁴ + k3 r⁶
              a′ = a d + 2 p1 a b + p2 (r² + 2 a²),   b′ = b d + p1 (r² + 2 b²) + 2 p2 a b
    fisheye   ϑ = atan r,   d = ϑ (1 + k1 ϑ² + k2 ϑ⁴ + k3 ϑ⁶ + k4 ϑ⁸) / r,   a′ = a d,   b′ = b d
    (u, v) = (fx a′ + cx, fy b′ + cy)

as OpenCV's (its documentation of calib3d; sources in `camera`). A polynomial of distortion rises only up to some
radius: past that the picture would fold back, so such points, and those behind the camera, have no pixel (NaN).
`models/observation/pinhole.py` has the same formulas for torch; a test holds the two equal.

Of rays of several cameras to N points: the points nearest to them, and the angles between them; with origins (C, 3),
directions aim (N, C, 3) of length 1, trust (N, C), 0 where a camera does not see the point.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from .camera import Calibration, Camera

NEWTON_STEPS = 50
"""Enough for a distant start; a pixel whose ray is not found by then has none."""


@dataclass(frozen=True)
class Lens:
    """The distortion of one camera, and its range of validity.

    Attributes:
        coefficients: as `Camera.distortion`.
        fisheye: which law.
        limit: largest r for which the distorted radius still rises; infinity for most.
    """

    coefficients: np.ndarray
    fisheye: bool
    limit: float

    @classmethod
    @lru_cache(maxsize=64)  # a camera never changes
    def of(cls, camera: Camera) -> "Lens":
        """The lens of a camera."""
        return cls(camera.distortion, camera.fisheye, valid_radius(camera.distortion, camera.fisheye))

    def distort(self, plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(…, 2) of the plane z = 1 → distorted (…, 2) and the derivatives (…, 2, 2)."""
        a, b = plane[..., 0], plane[..., 1]
        r2 = a * a + b * b
        if self.fisheye:
            d, slope = self._fisheye(r2)
            p1 = p2 = 0.0
        else:
            k1, k2, p1, p2, k3 = self.coefficients
            d = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of d, by r²
        u = a * d + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
        v = b * d + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
        cross = 2 * a * b * slope + 2 * p1 * a + 2 * p2 * b
        aa = d + 2 * a * a * slope + 2 * p1 * b + 6 * p2 * a
        bb = d + 2 * b * b * slope + 6 * p1 * b + 2 * p2 * a
        jacobian = np.stack([np.stack([aa, cross], -1), np.stack([cross, bb], -1)], -2)
        return np.stack([u, v], -1), jacobian

    def _fisheye(self, r2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d(r²) and its derivative by r²; near the axis by its series, where the quotient loses its digits."""
        k1, k2, k3, k4 = self.coefficients
        r = np.sqrt(np.maximum(r2, 1e-12))
        angle = np.arctan(r)
        t2 = angle * angle
        distorted = angle * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        steep = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        near = r2 < 1e-8
        d = np.where(near, 1 + (k1 - 1 / 3) * r2, distorted / r)
        slope = np.where(near, k1 - 1 / 3, (steep / (1 + r * r) - distorted / r) / (2 * r * r))
        return d, slope

    def undistort(self, distorted: np.ndarray) -> np.ndarray:
        """Invert `distort` by Newton's method with halved steps: (…, 2) → (…, 2), NaN where nothing is found."""
        plane = np.array(distorted, dtype=np.float64)
        with np.errstate(all="ignore"):  # a pixel far outside overflows, and ends as NaN
            if self.fisheye:
                plane = plane * self._first_guess(plane)
            for _ in range(NEWTON_STEPS):
                value, jacobian = self.distort(plane)
                error = distorted - value
                step = _solve2(jacobian, error)
                reach = 0.5 + 0.5 * np.linalg.norm(plane, axis=-1, keepdims=True)
                step /= np.maximum(1, np.linalg.norm(step, axis=-1, keepdims=True) / reach)
                plane = plane + step
                if not (np.abs(step) > 1e-11 * (1 + np.abs(plane))).any():  # the error left is its square
                    break
            error = np.linalg.norm(self.distort(plane)[0] - distorted, axis=-1)
            found = (error < 1e-9 * (1 + np.linalg.norm(distorted, axis=-1))) & (
                np.linalg.norm(plane, axis=-1) <= self.limit
            )
        return np.where(found[..., None], plane, np.nan)

    def _first_guess(self, distorted: np.ndarray) -> np.ndarray:
        """Factor of the equidistant lens without coefficients: r = tan ϑ′."""
        radius = np.maximum(np.linalg.norm(distorted, axis=-1, keepdims=True), 1e-12)
        return np.tan(np.minimum(radius, 1.5)) / radius


def valid_radius(coefficients: np.ndarray, fisheye: bool) -> float:
    """Largest r (of the plane z = 1) up to which the radial law rises; the tangential part is small and left out."""
    if fisheye:
        k1, k2, k3, k4 = coefficients
        squares = _positive_roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])  # of ϑ²
        angle = np.sqrt(squares.min(initial=np.inf))
        return float(np.tan(angle)) if angle < np.pi / 2 else np.inf
    k1, k2, _, _, k3 = coefficients
    squares = _positive_roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # of r²
    return float(np.sqrt(squares.min(initial=np.inf)))


def project(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Points of the scene (…, 3) → pixels (…, 2), NaN for a point behind the camera or past its lens's limit."""
    return project_with_jacobian(camera, points)[0]


def project_with_jacobian(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (…, 2); their derivatives (…, 2, 3) by the point in the camera's frame; that point (…, 3).

    Multiply the derivatives by R for those by the point in the scene. NaN as in `project`.
    """
    lens = Lens.of(camera)
    local = points @ camera.rotation.T + camera.translation
    with np.errstate(all="ignore"):
        ahead = local[..., 2] > 0
        depth = np.where(ahead, local[..., 2], np.nan)[..., None]
        plane = local[..., :2] / depth
        seen = np.linalg.norm(plane, axis=-1) <= lens.limit
        plane = np.where(seen[..., None], plane, np.nan)
        distorted, by_plane = lens.distort(plane)
        one, zero = np.ones_like(depth), np.zeros_like(depth)
        by_local = np.stack(
            [np.concatenate([one, zero, -plane[..., :1]], -1), np.concatenate([zero, one, -plane[..., 1:]], -1)], -2
        )
        jacobian = camera.focal[:, None] * (by_plane @ (by_local / depth[..., None]))
    return camera.focal * distorted + camera.center, jacobian, local


def undistort(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Pixels (…, 2) → (…, 2) of the plane z = 1 in front of the camera, NaN for a pixel that no ray reaches."""
    return Lens.of(camera).undistort((np.asarray(pixels, dtype=np.float64) - camera.center) / camera.focal)


def rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Pixels (…, 2) → unit vectors (…, 3) in the scene's frame, from the camera towards what it sees."""
    plane = undistort(camera, pixels)
    ahead = np.concatenate([plane, np.ones_like(plane[..., :1])], -1)
    return (ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)) @ camera.rotation


def _solve2(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Solve many systems of two equations: (…, 2, 2), (…, 2) → (…, 2)."""
    (a, b), (c, d) = np.moveaxis(matrix, (-2, -1), (0, 1))
    x, y = vector[..., 0], vector[..., 1]
    return np.stack([d * x - b * y, a * y - c * x], -1) / (a * d - b * c)[..., None]


def _positive_roots(polynomial: list[float]) -> np.ndarray:
    """Real positive roots of a polynomial, highest power first."""
    roots = np.roots(np.trim_zeros(polynomial, "f"))
    real = roots.real[np.abs(roots.imag) < 1e-9 * (1 + np.abs(roots))]
    return real[real > 0]


def nearest(origins: np.ndarray, aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """Points (N, 3) nearest to rays from origins (C, 3) along aim (N, C, 3): least squares of the distances."""
    projector = np.where(trust > 0, trust, 0)[..., None, None] * (np.eye(3) - aim[..., :, None] * aim[..., None, :])
    projector = np.nan_to_num(projector)
    normal = projector.sum(1) + 1e-12 * np.eye(3)
    return np.linalg.solve(normal, (projector @ origins[None, :, :, None]).sum(1))[..., 0]


def start_points(calibration: Calibration, aim: np.ndarray, trust: np.ndarray) -> list[np.ndarray]:
    """The point nearest to all rays, then those of each pair of cameras where there are more than two."""
    origins = np.stack([camera.position for camera in calibration])
    points = [nearest(origins, aim, trust)]
    if len(calibration) > 2:
        for pair in combinations(range(len(calibration)), 2):
            both = np.all(trust[:, pair] > 0, axis=1, keepdims=True)
            point = nearest(origins[list(pair)], aim[:, pair], trust[:, pair])
            points.append(np.where(both, point, points[0]))
    return points


def widest_angle(aim: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """(N,) rad, at most π/2, between the two rays that differ most: cameras that face each other determine no depth."""
    aim = np.where((trust > 0)[..., None], aim, np.nan)
    cross = np.linalg.norm(np.cross(aim[:, :, None], aim[:, None]), axis=-1)
    angle = np.arctan2(cross, np.abs((aim[:, :, None] * aim[:, None]).sum(-1)))
    return np.nanmax(angle, axis=(1, 2))
