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


def bootstrapped(columns: Sequence[np.ndarray], length: int, rules: Rules, seed: int = 0) -> np.ndarray:
    """Sums of each column (R,) over draws (D,) of all rows, in blocks of so many in a circle: (columns, D)."""
    rows = len(columns[0])
    starts = np.random.default_rng(seed).integers(rows, size=(rules.outcome.num_bootstraps, -(-rows // length)))
    whole = np.array([np.concatenate([[0.0], each, each[:length]]) for each in columns]).cumsum(1)
    return np.asarray((whole[:, starts + length] - whole[:, starts]).sum(-1))


def closing(before: np.ndarray, after: np.ndarray, memory: float, rules: Rules) -> TorqueClosing:
    """Of errors (R, K) without and with effects; ``memory`` is their correlation time, in rows."""
    rows = len(before)
    old, new = (np.sqrt((each**2).mean(0)) for each in (before, after))
    length = int(min(max(np.ceil(4 * memory), 1), max(rows // 8, 1)))
    drawn = bootstrapped([(each**2).sum(1) for each in (before, after)], length, rules)
    shares = 1 - np.sqrt(drawn[1] / np.maximum(drawn[0], 1e-300))
    low, high = np.quantile(shares, [0.05, 0.95]).tolist()
    sizes = [float(np.linalg.norm(each)) for each in (old, new)]
    whole = 1 - sizes[1] / sizes[0] if sizes[0] > 0 else 0.0
    return TorqueClosing(old, new, whole, (low, high), 1 - new / np.maximum(old, 1e-300))
