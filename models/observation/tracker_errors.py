"""Occasional errors of a tracker in a row of detections; :mod:`.mixture` makes a distribution of them.

Shapes: P keypoints in d dimensions; leading dimensions are parameter sets.
"""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Outlier:
    """Detections far from their keypoint: probability (..., 1) of each keypoint in each row, and sd, m.

    The sd is (..., 1, 1), the same for all, or (..., P, d) for each coordinate.
    """

    rate: Tensor
    scale: Tensor


@dataclass(frozen=True)
class Shift:
    """All keypoints of a row shifted together: probability (..., 1) of each row.

    The shift is ξ ``along`` (..., P, d) m, ξ ~ N(0, 1); each coordinate has an independent error of sd ``independent``
    (..., P, d) m in addition.
    """

    rate: Tensor
    along: Tensor
    independent: Tensor


@dataclass(frozen=True)
class Swap:
    """Two keypoints, by number, exchanged with a probability (..., 1) in each row."""

    one: int
    other: int
    rate: Tensor
