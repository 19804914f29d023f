"""A tracker's confidence c as a covariate of its noise, not as a probability. Noise grows as

    s(c) = exp(γ (1 − rank(c)) + δ (c⁺ − c) / (c⁺ − c⁻)),   γ, δ ≥ 0

rank(c) in (0, 1] is c's rank among that keypoint's own confidences, over their number; most differences between good
rows follow it. c⁻ and c⁺ are the least and the greatest of them. δ can make a few rows with c far below all others
nearly uninformative (noise times e^δ), while rows just above them in rank keep their noise. c may be of any scale.

Shapes: T rows, P keypoints.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

DEFAULT_SLOPE, DEFAULT_DROP = 0.1, 0.02
"""Starting values of γ and δ: small, but above 0, so that their gradients are not zero in log scale."""


@dataclass(frozen=True, eq=False)
class Confidence:
    """A tracker's confidence in its detections.

    Attributes:
        doubt: (T, P) 1 − rank(c).
        drop: (T, P) (c⁺ − c) / (c⁺ − c⁻), 1 where c is missing.
        itself: (T, P) 1 − c, 0 where it is missing.
    """

    doubt: Tensor
    drop: Tensor
    itself: Tensor

    @classmethod
    def of(cls, confidence: np.ndarray) -> Self:
        """Confidences (T, P); a missing one, NaN, ranks lowest."""
        from scipy.stats import rankdata  # half a second to import, which most runs do not need

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
    varies = greatest > least  # False in a column of one value, or of none
    fall = np.where(known & varies, greatest - confidence, 0.0) / np.where(varies, greatest - least, 1.0)
    return np.where(known, fall, 1.0)
