"""Rates, means and medians with 90 % intervals, and calibration.

rate      Wilson's interval (1927): (p̂ + z²/2n ± z √(p̂(1 − p̂)/n + z²/4n²)) / (1 + z²/n)
mean      ± z standard errors
median    order statistics, by the binomial with p = ½
Brier     mean of (p − correct)²;   ECE = Σ n_b/n |mean p − share correct| over bins of p (Guo et al. 2017)

z is the normal quantile of .95.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, norm

Z90 = float(norm.ppf(0.95))
CALIBRATION_BINS = 10  # of probability


@dataclass(frozen=True)
class Measure:
    """One figure of a score. `target` such as "≥ 0.97" or "0.85–0.95"; `unit` "share" (of `n` cases) or another."""

    name: str
    value: float | None
    low: float | None
    high: float | None
    n: int
    target: str = ""
    unit: str = "share"

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without a target or a value."""
        if not self.target or self.value is None:
            return None
        sign, _, number = self.target.partition(" ")
        if sign in ("≥", "≤"):
            return self.value >= float(number) if sign == "≥" else self.value <= float(number)
        low, high = (float(part) for part in self.target.split("–"))
        return low <= self.value <= high

    def to_json(self) -> dict:
        """As plain values."""
        return {
            "name": self.name,
            "value": self.value,
            "interval_90": None if self.low is None else [self.low, self.high],
            "n": self.n,
            "unit": self.unit,
            "target": self.target or None,
            "met": self.met,
        }


def rate(name: str, hits: Sequence[bool], target: str = "") -> Measure:
    """Share of hits, with Wilson's interval."""
    n = len(hits)
    if not n:
        return Measure(name, None, None, None, 0, target)
    p = float(np.mean([bool(hit) for hit in hits]))
    middle, half = p + Z90**2 / (2 * n), Z90 * np.sqrt(p * (1 - p) / n + Z90**2 / (4 * n**2))
    low, high = ((middle + sign * half) / (1 + Z90**2 / n) for sign in (-1, 1))
    return Measure(name, p, max(float(low), 0.0), min(float(high), 1.0), n, target)


def mean(name: str, values: Sequence[float], target: str = "", unit: str = "mean") -> Measure:
    """Mean and its standard error."""
    n = len(values)
    m = float(np.mean(values)) if n else None
    if m is None or n == 1:
        return Measure(name, m, None, None, n, target, unit)
    half = Z90 * float(np.std(values, ddof=1)) / np.sqrt(n)
    return Measure(name, m, m - half, m + half, n, target, unit)


def median(name: str, values: Sequence[float], target: str = "", unit: str = "median") -> Measure:
    """Median, between order statistics."""
    n = len(values)
    if not n:
        return Measure(name, None, None, None, 0, target, unit)
    ordered = np.sort(values)
    first = int(binom.ppf(0.05, n, 0.5))
    low, high = ordered[max(first - 1, 0)], ordered[min(n - first, n - 1)]
    return Measure(name, float(np.median(values)), float(low), float(high), n, target, unit)


@dataclass(frozen=True)
class Calibration:
    """How often answers of a probability are right. `bins`: (mean probability, share right, count) where any are."""

    bins: tuple[tuple[float, float, int], ...]
    brier: float | None
    ece: float | None

    def to_json(self) -> dict:
        """As plain values."""
        bins = [{"probability": p, "right": share, "n": n} for p, share, n in self.bins]
        return {"bins": bins, "brier": self.brier, "ece": self.ece}


def calibration(probability: Sequence[float], right: Sequence[bool]) -> Calibration:
    """Reliability of stated probabilities."""
    p, hit = np.asarray(probability, float), np.asarray(right, float)
    if not p.size:
        return Calibration((), None, None)
    place = np.minimum((p * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    bins = tuple(
        (float(p[place == b].mean()), float(hit[place == b].mean()), int((place == b).sum()))
        for b in range(CALIBRATION_BINS)
        if (place == b).any()
    )
    ece = sum(n * abs(stated - share) for stated, share, n in bins) / len(p)
    return Calibration(bins, float(np.mean((p - hit) ** 2)), float(ece))
