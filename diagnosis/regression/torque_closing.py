"""How much of a missing torque effects explain, on rows that they have not seen.

    closed = 1 − rms(with)/rms(without),   rms over rows, and over joints together

The 90 % interval is of the share in one more motion, as long as the rows held out. It differs from these as parts of
the log differ from each other. The held-out rows are split into F parts, and the fitted ones into parts as long. With a
and b the mean squares of the N parts, with and without, the ratio of their means has relative residuals r, and

    s² = Σ r²/(N − 1),     r = ½ (a/mean a − b/mean b)                              (Cochran 1977, ch. 6)
    log(1 − closed) ± t(.95; N − 1) s √(2/F)

where the 2 counts the held-out rows and the later ones.

Shapes: R rows held out, S rows fitted, K joints. Units: N·m.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import stdtrit

from invdyn.diagnosis.rules import FIXED

Errors = tuple[np.ndarray, np.ndarray]
"""Without and with effects."""


@dataclass(frozen=True)
class TorqueClosing:
    """Rms N·m without and with the effects, each (K,); the share of all joints together, with its 90 % interval."""

    before: np.ndarray
    after: np.ndarray
    share: float
    interval_90: tuple[float, float]

    def to_json(self, joints: Sequence[str]) -> dict[str, Any]:
        """As a JSON file has it."""
        by_joint = {
            "rms_before": self.before,
            "rms_after": self.after,
            "closed_by_joint": 1 - self.after / np.maximum(self.before, 1e-300),
        }
        named = {name: dict(zip(joints, values.tolist(), strict=True)) for name, values in by_joint.items()}
        return named | {"closed": self.share, "interval_90": list(self.interval_90)}


def share_closed(before: np.ndarray, after: np.ndarray, *fitted: Errors) -> tuple[float, float, float]:
    """Share of errors (R, …) without and with effects, and its 90 % interval: NaN where there is one part alone.

    A part has four rows, where there are two such: replays overlap by as many.
    """
    number = min(FIXED.cross_validation_folds, max(len(before) // 4, 2), len(before))
    squares = []
    for pair in ((before, after), *fitted):
        count = max(1, round(number * len(pair[0]) / len(before)))
        squares.append([[np.mean(part**2) for part in np.array_split(each, count)] for each in pair])
    old, new = np.maximum(np.concatenate(squares, 1), 1e-300)
    left = math.sqrt(max(np.mean(after**2), 1e-300) / max(np.mean(before**2), 1e-300))
    freedom = len(old) - 1
    if freedom == 0:
        return 1 - left, math.nan, math.nan
    residuals = 0.5 * (new / new.mean() - old / old.mean())
    sd = math.sqrt(2 / number * (residuals**2).sum() / freedom)
    ratio = math.exp(float(stdtrit(freedom, 0.95)) * sd)
    return 1 - left, 1 - left * ratio, 1 - left / ratio


def closing(before: np.ndarray, after: np.ndarray, fitted: Errors) -> TorqueClosing:
    """Of errors (R, K) on rows held out, without and with effects, and of those on ``fitted`` rows, (S, K)."""
    share, *interval = share_closed(before, after, fitted)
    old, new = (np.sqrt((each**2).mean(0)) for each in (before, after))
    return TorqueClosing(old, new, share, (interval[0], interval[1]))
