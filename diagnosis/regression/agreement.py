"""Whether recordings of one arm, or thirds of one, tell the same numbers: a meta-analysis with random effects.

Part r of R, fitted by itself, has the number θ_r with variance v_r (:mod:`.weighted_fit`), and

    w_r = 1/v_r,   W = Σ w_r,   θ̄ = Σ w_r θ_r/W,   Q = Σ w_r (θ_r − θ̄)²                 (Cochran 1954)
    τ² = (Q − (R − 1)) / (W − Σ w_r²/W)                                   (DerSimonian & Laird 1986)

Q is χ² of R − 1 degrees of freedom where all parts have the same θ. τ is the sd from part to part, and counts where
they do not: another recording's number is another draw.

Shapes: R parts, p coefficients, S sums of them.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc


@dataclass(frozen=True)
class Parts:
    """Coefficients (R, p) of parts by themselves, their covariances (R, p, p), and the level of one number's test."""

    values: np.ndarray
    covariance: np.ndarray
    level: float

    def turned(self, turn: np.ndarray) -> "Parts":
        """Of other coefficients, ``turn`` (q, p) times these."""
        return Parts(self.values @ turn.T, turn @ self.covariance @ turn.T, self.level)

    def sds(self, sums: np.ndarray) -> np.ndarray:
        """Of sums (S, p) of coefficients in each part, (R, S)."""
        variance = np.einsum("sp,rpq,sq->rs", sums, self.covariance, sums, optimize=True)
        return np.sqrt(np.maximum(variance, np.finfo(float).tiny))

    def spread(self, sums: np.ndarray) -> np.ndarray:
        """τ (S,) of sums (S, p) of coefficients; 0 where the parts tell the same."""
        chance, tau = agreement(self.values @ sums.T, self.sds(sums) ** 2)
        return np.where(chance < self.level, tau, 0.0)


def agreement(value: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How probable so much spread is by chance, and τ, (S,) each, of numbers (R, S) with variances (R, S)."""
    free, weight = len(value) - 1, 1 / variance
    total = weight.sum(0)
    q = (weight * (value - (weight * value).sum(0) / total) ** 2).sum(0)
    tau = np.sqrt(np.maximum(q - free, 0.0) / (total - (weight**2).sum(0) / total))
    return chdtrc(free, q), tau
