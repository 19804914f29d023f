"""A tracker's confidence c as a covariate of its noise, and no probability: noise grows as

    s(c) = exp(γ (1 − rank(c)))

where rank(c) in (0, 1] is c's place among that keypoint's own confidences, γ ≥ 0; so only the order of c matters.

Shapes: T rows, P keypoints.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from scipy.stats import rankdata
from torch import Tensor

USUAL_SLOPE = 0.1
"""γ where nothing is known of it."""


@dataclass(frozen=True, eq=False)
class Confidence:
    """What a tracker says of its detections.

    Attributes:
        doubt: (T, P) 1 − rank(c).
        itself: (T, P) 1 − c, 0 where it is not said.
    """

    doubt: Tensor
    itself: Tensor

    @classmethod
    def of(cls, confidence: np.ndarray) -> Self:
        """Confidences (T, P); a missing one, NaN, ranks lowest."""
        filled = np.where(np.isfinite(confidence), confidence, -np.inf)
        rank = rankdata(filled, method="max", axis=0) / len(filled)
        return cls(torch.as_tensor(1 - rank), torch.as_tensor(1 - np.nan_to_num(confidence, nan=1.0)))

    def to(self, device: torch.device | str) -> "Confidence":
        """The same on ``device``."""
        return Confidence(self.doubt.to(device), self.itself.to(device))

    def widened(self, scale: Tensor, slope: Tensor, t: int | Tensor) -> Tensor:
        """Noise scales (P,) at row ``t`` with slopes γ (P,): σ s(c), (..., P)."""
        return scale * torch.exp(slope * self.doubt[t].to(scale))
