"""A calibrated camera, and a set of them that looks at one scene.

A point X of the scene (3,) lies at x = R X + t in the camera's frame: x to the right of the picture, y down it, z
ahead. `projection` turns x into pixels. Lengths are metres when the set is metric; else one length of the scene is
still to be stated, and everything is known up to that factor.

The layout is OpenCV's: K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]; distortion (k1, k2, p1, p2, k3) after Brown,
"Close-range camera calibration", Photogrammetric Engineering 37, 1971, or (k1, k2, k3, k4) of a fisheye lens after
Kannala and Brandt, IEEE PAMI 28, 2006.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError

ROTATION_TOLERANCE = 1e-3
"""Of R Rᵀ − I, each entry: as much as rounding in a file causes."""
MAX_SIDE = 10**6
"""px, of a picture's side."""
MIN_FOCAL = 1e-3
"""px. A smaller one is zero up to rounding."""
MIN_DISTORTION = 1e-30
"""A smaller coefficient of distortion counts as 0: it is invisible, and its inverse overflows."""
MAX_VALUE = 1e9
"""Of any number of a camera: a thousand kilometres in mm. Powers of larger ones overflow."""


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera.

    Attributes:
        name: its tracks are given under this name.
        matrix: (3, 3) K, px, without skew.
        distortion: (5,) Brown's k1, k2, p1, p2, k3, or (4,) with `fisheye`; fewer of Brown's are filled with zeros.
        rotation: (3, 3) R, scene to camera.
        translation: (3,) t, in metres or the set's own unit.
        size: width and height of the picture, px, or None when the calibration does not state it.
        fisheye: which law of distortion.

    Raises:
        InputError: shapes that do not fit, values that are not finite or beyond `MAX_VALUE`, a focal length below
            `MIN_FOCAL`, skew, a matrix that is not a rotation, a size beyond `MAX_SIDE`.
    """

    name: str
    matrix: np.ndarray
    distortion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    size: tuple[int, int] | None = None
    fisheye: bool = False

    def __post_init__(self) -> None:
        for field, shape in (("matrix", (3, 3)), ("rotation", (3, 3)), ("translation", (3,))):
            object.__setattr__(self, field, self._numbers(field, shape))
        object.__setattr__(self, "distortion", self._coefficients())
        self._check_matrix()
        self._check_rotation()
        if self.size is not None:
            width, height = self._numbers("size", (2,)).tolist()
            if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
                raise InputError(
                    f"camera {self.name!r}: expected size as width and height in px, got [{width:g}, {height:g}]"
                )
            object.__setattr__(self, "size", (int(width), int(height)))

    def _numbers(self, field: str, shape: tuple[int, ...] | None) -> np.ndarray:
        try:
            values = np.array(getattr(self, field), dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"camera {self.name!r}: {field} must be numbers") from None
        if shape is not None and values.shape != shape:
            raise InputError(f"camera {self.name!r}: {field} must have shape {shape}, got {values.shape}")
        if not np.isfinite(values).all():
            raise InputError(f"camera {self.name!r}: {field} has a value that is not finite")
        if values.size and (largest := np.abs(values).max()) > MAX_VALUE:
            raise InputError(f"camera {self.name!r}: {field} has a value beyond 10⁹, {largest:.3g}: no camera's is")
        return values

    def _coefficients(self) -> np.ndarray:
        given = self._numbers("distortion", None).ravel()
        given[np.abs(given) < MIN_DISTORTION] = 0.0
        most = 4 if self.fisheye else 5
        if given[most:].any():
            law = "a fisheye lens has 4" if self.fisheye else "Brown's law has 5 (k1, k2, p1, p2, k3)"
            raise InputError(
                f"camera {self.name!r}: {law} coefficients of distortion, got {given.size}: calibrate with that model"
            )
        return np.concatenate([given[:most], np.zeros(max(0, most - given.size))])

    def _check_matrix(self) -> None:
        (fx, skew, _), (zero, fy, _), last = self.matrix
        if not (fx >= MIN_FOCAL and fy >= MIN_FOCAL):
            raise InputError(f"camera {self.name!r}: focal lengths must be positive, got {fx:g} and {fy:g} px")
        if skew or zero or list(last) != [0.0, 0.0, 1.0]:
            raise InputError(
                f"camera {self.name!r}: expected the matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] without skew"
            )

    def _check_rotation(self) -> None:
        error = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if error > ROTATION_TOLERANCE or np.linalg.det(self.rotation) < 0:
            raise InputError(
                f"camera {self.name!r}: its matrix is not a rotation (off by {error:.2g}, determinant "
                f"{np.linalg.det(self.rotation):.3g}): expected a rotation from the scene to the camera"
            )

    @property
    def focal(self) -> np.ndarray:
        """(2,) fx, fy, px."""
        return self.matrix[[0, 1], [0, 1]]

    @property
    def center(self) -> np.ndarray:
        """(2,) principal point cx, cy, px."""
        return self.matrix[:2, 2]

    @property
    def position(self) -> np.ndarray:
        """(3,) position in the scene: −Rᵀ t."""
        return -self.rotation.T @ self.translation

    def scaled(self, factor: float) -> "Camera":
        """The same camera in a scene that is `factor` times as large."""
        return replace(self, translation=self.translation * factor)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Cameras that look at one scene, in its frame.

    Attributes:
        cameras: one or more, of different names.
        metric: lengths are metres; otherwise they are known up to one factor.
        error: reprojection error that the calibration itself reports, RMS px, or None.

    Raises:
        InputError: no camera, or a name twice.
    """

    cameras: tuple[Camera, ...]
    metric: bool
    error: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if not self.cameras:
            raise InputError("expected one camera or more, got none")
        for name in (names := self.names):
            if names.count(name) > 1:
                raise InputError(f"two cameras are called {name!r}: give each its own name")

    @property
    def names(self) -> tuple[str, ...]:
        """Of the cameras, in their order."""
        return tuple(camera.name for camera in self.cameras)

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def select(self, names: Sequence[str]) -> "Calibration":
        """The named cameras, in that order. Raises InputError for one that is not there."""
        known = dict(zip(self.names, self.cameras, strict=True))
        for name in names:
            if name not in known:
                raise InputError(f"no camera {name!r} in the calibration: it has {', '.join(self.names)}")
        return replace(self, cameras=tuple(known[name] for name in names))

    def scaled(self, factor: float, metric: bool = True) -> "Calibration":
        """The same cameras in a scene `factor` times as large. Raises InputError unless it is positive and finite."""
        if not (np.isfinite(factor) and factor > 0):
            raise InputError(f"a scale must be positive and finite, got {factor}")
        return replace(self, cameras=tuple(camera.scaled(factor) for camera in self.cameras), metric=metric)

    def rotated(self, rotation: np.ndarray) -> "Calibration":
        """The same cameras in a frame that `rotation` (3, 3) takes the present one to: X′ = rotation X."""
        cameras = (replace(camera, rotation=camera.rotation @ rotation.T) for camera in self.cameras)
        return replace(self, cameras=tuple(cameras))

    def baseline(self, first: str, second: str) -> float:
        """Distance of two cameras. Raises InputError for one that is not there."""
        one, two = self.select([first, second])
        return float(np.linalg.norm(one.position - two.position))
