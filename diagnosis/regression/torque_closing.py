"""How much of a missing torque effects explain, on rows that they have not seen.

    closed = 1 − rms(with)/rms(without),   rms over rows, and over joints together

The interval is of a circular bootstrap of rows in blocks of several correlation times (Politis & Romano 1992).

Shapes: R rows, K joints. Units: N·m.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.diagnosis.rules import Rules


@dataclass(frozen=True)
class TorqueClosing:
    """Rms N·m without and with the effects, each (K,); shares of all joints and of each, with their 90 % intervals."""

    before: np.ndarray
    after: np.ndarray
    share: float
    interval_90: tuple[float, float]
    by_joint: np.ndarray

    def to_json(self, joints: Sequence[str]) -> dict[str, Any]:
        """As a JSON file has it."""

        def named(values: np.ndarray) -> dict[str, float]:
            return dict(zip(joints, values.tolist(), strict=True))

        return {
            "rms_before": named(self.before),
            "rms_after": named(self.after),
            "closed": self.share,
            "interval_90": list(self.interval_90),
            "closed_by_joint": named(self.by_joint),
        }


def closing(before: np.ndarray, after: np.ndarray, memory: float, rules: Rules) -> TorqueClosing:
    """Of errors (R, K) without and with effects; ``memory`` is their correlation time, in rows."""
    rows = len(before)
    old, new = (np.sqrt((each**2).mean(0)) for each in (before, after))
    length = int(min(max(np.ceil(4 * memory), 1), max(rows // 8, 1)))
    draws = rules.outcome.num_bootstraps
    starts = np.random.default_rng(0).integers(rows, size=(draws, -(-rows // length)))
    squares = [np.concatenate([each, each[:length]]) for each in ((before**2).sum(1), (after**2).sum(1))]
    totals = [np.concatenate([[0.0], each.cumsum()]) for each in squares]
    drawn = [(total[starts + length] - total[starts]).sum(1) for total in totals]
    shares = 1 - np.sqrt(drawn[1] / np.maximum(drawn[0], 1e-300))
    low, high = np.quantile(shares, [0.05, 0.95]).tolist()
    sizes = [float(np.linalg.norm(each)) for each in (old, new)]
    whole = 1 - sizes[1] / sizes[0] if sizes[0] > 0 else 0.0
    return TorqueClosing(old, new, whole, (low, high), 1 - new / np.maximum(old, 1e-300))
