"""Left and right exchanged: a tracker that takes a person's left side for the right one, for a while, in one view.

Seen from the side, a person has two sides that look alike, and trackers of poses swap them. All keypoints of the row
then jump at once, each to where its twin was. In one camera's tracks let a keypoint move by d between rows;

    log p(d) = −(ν + 2)/2 · log(1 + d²/(ν s²)) + constant,    ν = 4, s the median movement of all,

a Student-t in the plane, and let sides be exchanged from one row to the next with a probability of `RARE`. Whether they
are is then told by each step alone: the two readings of the later row differ by Σ log p, and the sum starts from the
prior's log-odds. What no movement tells is which of the two runs is right: a tracker is right in most rows.

Shapes: T rows, P keypoints, C cameras.
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .views import Views

RARE = 0.01
"""Probability that sides are exchanged between two rows, or back."""
FREEDOM = 4.0
LEAST = 0.5
"""px that a keypoint moves at least in a typical row, so that a still scene has a scale."""
SIDE = re.compile(r"(?i)(?:(?<=^)|(?<=[\W_]))(left|right|l|r)(?=[\W_]|$)")
TWIN = {"left": "right", "right": "left", "l": "r", "r": "l"}


def pairs_of(names: Sequence[str]) -> list[tuple[int, int]]:
    """Keypoints of two sides, left_wrist and right_wrist or L_wrist and R_wrist, as pairs of places."""
    plain = [name.lower() for name in names]
    twins = [SIDE.sub(lambda found: TWIN[found[1].lower()], name, count=1) for name in plain]
    return [(p, plain.index(twin)) for p, twin in enumerate(twins) if twin in plain[p + 1 :]]


def exchanged(pixels: np.ndarray, pairs: Sequence[tuple[int, int]]) -> np.ndarray:
    """Rows (T,) of one camera's tracks (T, P, 2) in which left and right are exchanged.

    A step in which none of a pair is seen on both of its rows tells nothing, and the side stays.
    """
    own = [p for pair in pairs for p in pair]
    other = [p for pair in pairs for p in reversed(pair)]
    if not own or len(pixels) < 2:
        return np.zeros(len(pixels), bool)
    same = np.linalg.norm(pixels[1:, own] - pixels[:-1, own], axis=-1)
    crossed = np.linalg.norm(pixels[1:, other] - pixels[:-1, own], axis=-1)
    if not np.isfinite(same).any():
        return np.zeros(len(pixels), bool)
    scale = max(float(np.nanmedian(same)), LEAST)

    def fit(moved: np.ndarray) -> np.ndarray:
        # Both readings need the same detections: what one of them lacks counts in neither.
        both = np.isfinite(same) & np.isfinite(crossed)
        terms = -(FREEDOM + 2) / 2 * np.log1p((np.where(both, moved, 0.0) / scale) ** 2 / FREEDOM)
        return terms.sum(-1)

    jumps = fit(crossed) - fit(same) > np.log((1 - RARE) / RARE)
    off = np.concatenate([[False], np.cumsum(jumps) % 2 == 1])
    return ~off if off.mean() > 0.5 else off


def sides_kept(views: Views) -> tuple[Views, np.ndarray]:
    """Tracks whose left and right stay what they are, and the rows (T, C) in which they were exchanged.

    Each camera is looked at by itself; keypoints without a twin in the names stay as they are.
    """
    pairs = pairs_of(views.keypoint_names)
    turned = np.stack([exchanged(views.pixels[:, c], pairs) for c in range(len(views.calibration))], 1)
    order = np.arange(len(views.keypoint_names))
    for one, twin in pairs:
        order[one], order[twin] = twin, one
    pixels = np.where(turned[..., None, None], views.pixels[:, :, order], views.pixels)
    confidence = np.where(turned[..., None], views.confidence[:, :, order], views.confidence)
    return replace(views, pixels=pixels, confidence=confidence), turned


def put_in_order(views: Views) -> Views:
    """Tracks whose left and right stay what they are; a UserWarning says of each camera how many rows were put back."""
    kept, turned = sides_kept(views)
    for name, rows in zip(views.calibration.names, turned.T, strict=True) if turned.any() else ():
        if rows.any():
            warnings.warn(
                f"camera {name}: left and right are exchanged in {rows.sum()} of {len(rows)} rows; they were put back",
                UserWarning,
                stacklevel=3,
            )
    return kept
