"""Left and right exchanged: a tracker that takes a person's left side for the right one, for a while, in one view.

Seen from the side, a person's two sides look the same, and trackers of poses swap them. All keypoints of the row then
jump at once, each to the position of its counterpart. In one camera's tracks let a keypoint move by d between rows;

    log p(d) = −(ν + 2)/2 · log(1 + d²/(ν s²)) + constant,    ν = 4, s the median movement of all,

a Student-t in the plane, and let sides be exchanged from one row to the next with a probability of
`EXCHANGE_PROBABILITY`. Each step alone then decides: the log-odds of an exchange are Σ log p of the crossed movement
less that of the direct one, plus the prior's. Movement does not show which of the two runs is right; the longer one is
taken to be, as a tracker is right in most rows.

Shapes: T rows, P keypoints, C cameras.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .views import Views

EXCHANGE_PROBABILITY = 0.01
"""That sides are exchanged from one row to the next."""
DEGREES_OF_FREEDOM = 4.0  # ν
MIN_MOVEMENT = 0.5
"""px, lower bound of s, for a scene without movement."""
SIDE = re.compile(r"(?i)(?:(?<=^)|(?<=[\W_]))(left|right|l|r)(?=[\W_]|$)")
COUNTERPART = {"left": "right", "right": "left", "l": "r", "r": "l"}


def pairs_of(names: Sequence[str]) -> list[tuple[int, int]]:
    """Keypoints of two sides, left_wrist and right_wrist or L_wrist and R_wrist, as pairs of indices."""
    plain = [name.lower() for name in names]
    counterparts = [SIDE.sub(lambda found: COUNTERPART[found[1].lower()], name, count=1) for name in plain]
    return [
        (p, plain.index(counterpart)) for p, counterpart in enumerate(counterparts) if counterpart in plain[p + 1 :]
    ]


def exchanged(pixels: np.ndarray, pairs: Sequence[tuple[int, int]]) -> np.ndarray:
    """Rows (T,) of one camera's tracks (T, P, 2) in which left and right are exchanged.

    A step in which no pair is seen in both rows leaves the sides as they are.
    """
    own = [p for pair in pairs for p in pair]
    other = [p for pair in pairs for p in reversed(pair)]
    if not own or len(pixels) < 2:
        return np.zeros(len(pixels), bool)
    same = np.linalg.norm(pixels[1:, own] - pixels[:-1, own], axis=-1)
    crossed = np.linalg.norm(pixels[1:, other] - pixels[:-1, own], axis=-1)
    if not np.isfinite(same).any():
        return np.zeros(len(pixels), bool)
    scale = max(float(np.nanmedian(same)), MIN_MOVEMENT)

    def fit(moved: np.ndarray) -> np.ndarray:
        # Both readings need the same detections: what one of them lacks counts in neither.
        both = np.isfinite(same) & np.isfinite(crossed)
        terms = -(DEGREES_OF_FREEDOM + 2) / 2 * np.log1p((np.where(both, moved, 0.0) / scale) ** 2 / DEGREES_OF_FREEDOM)
        return terms.sum(-1)

    jumps = fit(crossed) - fit(same) > np.log((1 - EXCHANGE_PROBABILITY) / EXCHANGE_PROBABILITY)
    off = np.concatenate([[False], np.cumsum(jumps) % 2 == 1])
    return ~off if off.mean() > 0.5 else off


def sides_kept(views: Views) -> tuple[Views, np.ndarray]:
    """Tracks whose left and right are consistent, and the rows (T, C) in which they were exchanged.

    Cameras are independent; keypoints without a counterpart in the names stay as they are.
    """
    pairs = pairs_of(views.keypoint_names)
    exchanges = np.stack([exchanged(views.pixels[:, c], pairs) for c in range(len(views.calibration))], 1)
    order = np.arange(len(views.keypoint_names))
    for one, counterpart in pairs:
        order[one], order[counterpart] = counterpart, one
    pixels = np.where(exchanges[..., None, None], views.pixels[:, :, order], views.pixels)
    confidence = np.where(exchanges[..., None], views.confidence[:, :, order], views.confidence)
    return replace(views, pixels=pixels, confidence=confidence), exchanges


def put_in_order(views: Views) -> Views:
    """Tracks whose left and right are consistent; a UserWarning counts the corrected rows of each camera."""
    kept, exchanges = sides_kept(views)
    for name, rows in zip(views.calibration.names, exchanges.T, strict=True):
        if rows.any():
            warnings.warn(
                f"camera {name}: left and right are exchanged in {rows.sum()} of {len(rows)} rows; they were put back",
                UserWarning,
                stacklevel=3,
            )
    return kept
