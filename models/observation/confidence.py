"""A tracker's confidence c is a covariate of its noise, and no probability. Noise grows as

    s(c) = exp(γ (1 − rank(c)) + δ (c⁺ − c) / (c⁺ − c⁻)),   γ, δ ≥ 0

rank(c) in (0, 1] is c's place among that keypoint's own confidences; most differences between good rows follow it. c⁻
and c⁺ are the least and the greatest of them. By δ, a few rows whose c lies far below all others can be as good as
lost (e^δ), while the rows just above them in order stay sure. c may be of any scale.

Shapes: T rows, P keypoints.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from scipy.stats import rankdata
from torch import Tensor

USUAL_SLOPE, USUAL_DROP = 0.1, 0.02
"""γ and δ where nothing is known of them: above 0, where a search for them can begin."""


@dataclass(frozen=True, eq=False)
class Confidence:
    """What a tracker says of its detections.

    Attributes:
        doubt: (T, P) 1 − rank(c).
        drop: (T, P) (c⁺ − c) / (c⁺ − c⁻), 1 where c is not said.
        itself: (T, P) 1 − c, 0 where it is not said.
    """

    doubt: Tensor
    drop: Tensor
    itself: Tensor

    @classmethod
    def of(cls, confidence: np.ndarray) -> Self:
        """Confidences (T, P); a missing one, NaN, ranks lowest."""
        filled = np.where(np.isfinite(confidence), confidence, -np.inf)
        rank = rankdata(filled, method="max", axis=0) / len(filled)
        itself = 1 - np.nan_to_num(confidence, nan=1.0)
        return cls(*map(torch.as_tensor, (1 - rank, _drop(confidence), itself)))

    def to(self, device: torch.device | str) -> "Confidence":
        """The same on ``device``."""
        return Confidence(self.doubt.to(device), self.drop.to(device), self.itself.to(device))

    def widened(self, scale: Tensor, slope: Tensor, drop: Tensor, t: int | Tensor) -> Tensor:
        """Noise scales (P,) at row ``t`` with γ and δ (P,) each: σ s(c), (..., P)."""
        return scale * torch.exp(slope * self.doubt[t].to(scale) + drop * self.drop[t].to(scale))


def _drop(confidence: np.ndarray) -> np.ndarray:
    """How far each entry lies below its column's greatest, of the column's range: in [0, 1]; 1 where it is missing."""
    known = np.isfinite(confidence)
    least = np.where(known, confidence, np.inf).min(axis=0)
    greatest = np.where(known, confidence, -np.inf).max(axis=0)
    apart = greatest > least  # False in a column of one value, or of none
    fall = np.where(known & apart, greatest - confidence, 0.0) / np.where(apart, greatest - least, 1.0)
    return np.where(known, fall, 1.0)
