"""Boards that calibrate a camera: a checkerboard or a ChArUco board, found in a picture by OpenCV (extra `cameras`).

A checkerboard is named by its inner corners, 9x6 for ten by seven squares; a ChArUco board by its squares. Corners have
numbers and positions on the board, (n, 3) m, z = 0. A checkerboard rotated by half a revolution looks the same unless
one side is odd and the other even: then the first square is dark, and every camera numbers its corners in the same
order.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import InputError

KINDS = ("checkerboard", "charuco")
MIN_CORNERS = 6
"""Corners that a picture must show. A ChArUco board may be half hidden."""


def opencv() -> Any:
    """The library. Raises InputError with the fix when it is not installed."""
    try:
        import cv2
    except ImportError:
        raise InputError("calibration from boards needs OpenCV: pip install 'invdyn[cameras]'") from None
    return cv2


@dataclass(frozen=True)
class Board:
    """A board.

    Attributes:
        kind: of `KINDS`.
        columns, rows: inner corners of a checkerboard, squares of a ChArUco board.
        square: side, m.
        marker: side of a ChArUco board's markers, m; default: half the square's.
        dictionary: of a ChArUco board's markers, as OpenCV calls it.

    Raises:
        InputError: an unknown kind or dictionary, fewer than 3 columns or rows, sizes that are not positive, or markers
            that are not smaller than squares.
    """

    kind: str
    columns: int
    rows: int
    square: float
    marker: float | None = None
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"unknown board {self.kind!r}: known are {', '.join(KINDS)}")
        if min(self.columns, self.rows) < 3:
            raise InputError(f"a board has 3 columns and rows or more, got {self.columns} × {self.rows}")
        if not (np.isfinite(self.square) and self.square > 0):
            raise InputError(f"a board's square must be positive, in metres, got {self.square}")
        if self.square > 1:
            raise InputError(f"a board whose squares are {self.square:g} m wide? Give metres, such as 0.025")
        if self.kind == "charuco":
            marker = self.square / 2 if self.marker is None else self.marker
            object.__setattr__(self, "marker", marker)
            if not 0 < marker < self.square:
                raise InputError(f"markers must be smaller than squares, got {marker:g} and {self.square:g} m")
            if not hasattr(opencv().aruco, self.dictionary):
                raise InputError(f"unknown dictionary of markers {self.dictionary!r}: expected one such as DICT_4X4_50")

    @classmethod
    def parse(cls, text: str, square: float, marker: float | None = None, dictionary: str = "DICT_4X4_50") -> "Board":
        """Read "checkerboard:9x6" or "charuco:7x5". Raises InputError for anything else."""
        kind, _, size = text.partition(":")
        columns, _, rows = size.lower().partition("x")
        if not (columns.isdigit() and rows.isdigit()):
            raise InputError(f"a board is checkerboard:9x6 (inner corners) or charuco:7x5 (squares), got {text!r}")
        return cls(kind, int(columns), int(rows), square, marker, dictionary)

    @property
    def is_unambiguous(self) -> bool:
        """Whether two cameras number the corners in the same order for every orientation of the board."""
        return self.kind == "charuco" or (self.columns + self.rows) % 2 == 1

    @cached_property
    def corners(self) -> np.ndarray:
        """(n, 3) m, row by row."""
        columns, rows = (self.columns, self.rows) if self.kind == "checkerboard" else (self.columns - 1, self.rows - 1)
        grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2)
        return np.concatenate([self.square * (grid + (self.kind == "charuco")), np.zeros((len(grid), 1))], -1)

    @cached_property
    def charuco(self) -> Any:
        """OpenCV's own object of a ChArUco board."""
        cv2 = opencv()
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, dictionary)

    def find(self, picture: np.ndarray) -> np.ndarray | None:
        """Pixels (n, 2) of all corners in a grey picture (H, W) uint8, NaN of those not seen; None without a board."""
        found = self._find_checkerboard(picture) if self.kind == "checkerboard" else self._find_charuco(picture)
        return found if found is not None and np.isfinite(found).all(-1).sum() >= MIN_CORNERS else None

    def _find_checkerboard(self, picture: np.ndarray) -> np.ndarray | None:
        cv2 = opencv()
        there, corners = cv2.findChessboardCornersSB(picture, (self.columns, self.rows), cv2.CALIB_CB_ACCURACY)
        if not there:
            return None
        corners = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        if self.is_unambiguous and not self._first_is_dark(picture, corners):
            corners = corners[::-1]
        return corners

    def _first_is_dark(self, picture: np.ndarray, corners: np.ndarray) -> bool:
        """Squares of the first one's colour against the others, by the grey at their centres."""
        grid = corners.reshape(self.rows, self.columns, 2)
        centers = (grid[:-1, :-1] + grid[1:, 1:] + grid[:-1, 1:] + grid[1:, :-1]) / 4
        column, row = np.moveaxis(np.rint(centers).astype(int), -1, 0)
        grey = picture[np.clip(row, 0, picture.shape[0] - 1), np.clip(column, 0, picture.shape[1] - 1)].astype(float)
        first = np.indices(grey.shape).sum(0) % 2 == 0
        return grey[first].mean() < grey[~first].mean()

    def _find_charuco(self, picture: np.ndarray) -> np.ndarray | None:
        corners, numbers, _, _ = opencv().aruco.CharucoDetector(self.charuco).detectBoard(picture)
        if corners is None or numbers is None:
            return None
        whole = np.full((len(self.corners), 2), np.nan)
        whole[np.ravel(numbers)] = np.reshape(corners, (-1, 2))
        return whole
