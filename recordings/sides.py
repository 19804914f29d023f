"""Left and right exchanged: a tracker that takes a person's left side for the right one, for a while, in one view.

Seen from the side, a person's two sides look the same, and trackers of poses swap them. All keypoints of the row then
jump at once, each to the position of its counterpart. In one view let a keypoint move by d between rows;

    log p(d) = −(ν + 2)/2 · log(1 + d²/(ν s²)) + constant,    ν = 4, s the median movement of all,

a Student-t in the plane, and let sides be exchanged from one row to the next with a probability of
`EXCHANGE_PROBABILITY`. Each step alone then decides: the log-odds of an exchange are Σ log p of the crossed movement
less that of the direct one, plus the prior's. Movement does not show which of the two runs is right; the longer one is
taken to be, as a tracker is right in most rows.

Shapes: T rows, P keypoints.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .recording import Recording

EXCHANGE_PROBABILITY = 0.01
"""That sides are exchanged from one row to the next."""
DEGREES_OF_FREEDOM = 4.0  # ν
MIN_MOVEMENT = 0.5
"""px, lower bound of s, for a scene without movement."""
MIN_OF_DISTANCE = 0.01
"""The same, where a unit is not known, as a share of the distance of two counterparts."""
SIDE = re.compile(r"(?i)(?:(?<=^)|(?<=[\W_]))(left|right|l|r)(?=[\W_]|$)")
COUNTERPART = {"left": "right", "right": "left", "l": "r", "r": "l"}


def pairs_of(names: Sequence[str]) -> list[tuple[int, int]]:
    """Keypoints of two sides, left_wrist and right_wrist or L_wrist and R_wrist, as pairs of indices."""
    plain = [name.lower() for name in names]
    counterparts = [SIDE.sub(lambda found: COUNTERPART[found[1].lower()], name, count=1) for name in plain]
    return [
        (p, plain.index(counterpart)) for p, counterpart in enumerate(counterparts) if counterpart in plain[p + 1 :]
    ]


def exchanged(points: np.ndarray, pairs: Sequence[tuple[int, int]], least: float = MIN_MOVEMENT) -> np.ndarray:
    """Rows (T,) of one view's tracks (T, P, S) in which left and right are exchanged.

    A step in which no pair is seen in both rows leaves the sides as they are. ``least`` bounds s from below.
    """
    own = [p for pair in pairs for p in pair]
    other = [p for pair in pairs for p in reversed(pair)]
    if not own or len(points) < 2:
        return np.zeros(len(points), bool)
    same = np.linalg.norm(points[1:, own] - points[:-1, own], axis=-1)
    crossed = np.linalg.norm(points[1:, other] - points[:-1, own], axis=-1)
    if not np.isfinite(same).any():
        return np.zeros(len(points), bool)
    scale = max(float(np.nanmedian(same)), least)

    def fit(moved: np.ndarray) -> np.ndarray:
        # Both readings need the same detections: what one of them lacks counts in neither.
        both = np.isfinite(same) & np.isfinite(crossed)
        terms = -(DEGREES_OF_FREEDOM + 2) / 2 * np.log1p((np.where(both, moved, 0.0) / scale) ** 2 / DEGREES_OF_FREEDOM)
        return terms.sum(-1)

    jumps = fit(crossed) - fit(same) > np.log((1 - EXCHANGE_PROBABILITY) / EXCHANGE_PROBABILITY)
    off = np.concatenate([[False], np.cumsum(jumps) % 2 == 1])
    return ~off if off.mean() > 0.5 else off


def partners(names: Sequence[str]) -> np.ndarray:
    """Of each keypoint the index of its counterpart, or its own without one."""
    order = np.arange(len(names))
    for one, counterpart in pairs_of(names):
        order[one], order[counterpart] = counterpart, one
    return order


def with_sides_put_back(recording: Recording) -> Recording:
    """One camera's tracks whose left and right are consistent; a UserWarning counts the rows and names the first."""
    pairs = pairs_of(recording.keypoint_names)
    points = recording.keypoints
    if not pairs:
        return recording
    sizes = [np.linalg.norm(points[:, one] - points[:, other], axis=-1) for one, other in pairs]
    apart = np.concatenate(sizes)
    typical = float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else 0.0
    rows = exchanged(points, pairs, max(MIN_OF_DISTANCE * typical, 1e-300))
    if not rows.any():
        return recording
    order, first = partners(recording.keypoint_names), int(rows.argmax())
    warnings.warn(
        f"{recording.name}: left and right are exchanged in {rows.sum()} of {len(rows)} rows, first in row {first + 1} "
        f"({recording.time[first]:.6g} s); they were put back",
        stacklevel=4,
    )
    confidence = recording.confidence
    return replace(
        recording,
        keypoints=np.where(rows[:, None, None], points[:, order], points),
        confidence=None if confidence is None else np.where(rows[:, None], confidence[:, order], confidence),
    )
