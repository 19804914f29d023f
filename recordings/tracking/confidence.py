"""A tracker's confidence as a probability: that the point lies within a tolerance of where a person would put it.

Platt (Advances in Large Margin Classifiers, 1999): of labels that the network was not trained on, the logarithm s of
the odds of a peak's mass, and whether the point was within the tolerance, fit

    P(within) = 1 / (1 + exp(−(a s + b)))        a ≥ 0

with his smoothed targets (n₊ + 1)/(n₊ + 2) and 1/(n₋ + 2): a few labels, all right, do not give certainty. Labels that
are all right do not determine the slope: a prior, a ~ N(1, ½²), then keeps the network's own.
"""

import numpy as np
from scipy.optimize import minimize

MASS_MARGIN = 1e-6  # least distance of a mass from 0 and 1


def log_odds(mass: np.ndarray) -> np.ndarray:
    """Of masses from 0 to 1, any shape."""
    inside = np.clip(mass, MASS_MARGIN, 1 - MASS_MARGIN)
    return np.log(inside) - np.log1p(-inside)


def fit_platt(mass: np.ndarray, within: np.ndarray) -> tuple[float, float]:
    """A and b of masses (n,) and whether each was within the tolerance (n,); the identity, (1, 0), without any."""
    if len(mass) == 0:
        return 1.0, 0.0
    s, right = log_odds(mass), int(within.sum())
    wrong = len(within) - right
    target = np.where(within, (right + 1) / (right + 2), 1 / (wrong + 2))

    def loss(parameters: np.ndarray) -> float:
        z = parameters[0] * s + parameters[1]
        return float(np.sum(np.logaddexp(0, z) - target * z) + 2 * (parameters[0] - 1) ** 2)

    best = minimize(loss, [1.0, 0.0], bounds=[(0.0, None), (None, None)])
    return float(best.x[0]), float(best.x[1])


def platt(mass: np.ndarray, a: float, b: float) -> np.ndarray:
    """Probabilities of masses, any shape."""
    return 1 / (1 + np.exp(-(a * log_odds(mass) + b)))
