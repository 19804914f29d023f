"""What a tracker gets wrong now and then in a row of detections; :mod:`.mixture` makes a distribution of it.

Shapes: P keypoints in d dimensions; leading dimensions are parameter sets.
"""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Stray:
    """Detections from elsewhere: probability (..., 1) of each keypoint in each row, and width, m.

    The width is (..., 1, 1) for all alike, or (..., P, d) for each coordinate.
    """

    rate: Tensor
    scale: Tensor


@dataclass(frozen=True)
class Shift:
    """All keypoints of a row off together: probability (..., 1) of each row.

    By ξ ``along`` (..., P, d) m, ξ ~ N(0, 1), and each coordinate by ``beside`` (..., P, d) m more, its own deviation.
    """

    rate: Tensor
    along: Tensor
    beside: Tensor


@dataclass(frozen=True)
class Swap:
    """Two keypoints, by number, exchanged with a probability (..., 1) in each row."""

    one: int
    other: int
    rate: Tensor
