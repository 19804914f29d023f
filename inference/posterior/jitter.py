"""The noise of what was recorded, from what a smooth motion cannot explain: differences of a high order.

The noise of a point in d dimensions is one number σ for all axes, from the median length of vectors σ ν,

    σ = median |σ ν| / √(median of χ² with d degrees of freedom),

so that it does not depend on how the axes are turned. With d = 1 this is 1.4826 times the median absolute deviation.

Shapes: columns (T, C) of C numbers in T rows; points (T, P, d). NaN where missing.
"""

import math

import numpy as np
from scipy.stats import chi2

ORDERS, HIGHER = (3, 4, 5), (10, 15)
"""Of the differences that noise is estimated from, and of those that a very fast motion needs."""
SURELY = 3.0
"""Standard deviations by which a higher order must show less."""
MEDIAN = 1.36
"""n times the relative variance of the median of the sizes of n Gaussians."""


def jitter(columns: np.ndarray) -> np.ndarray:
    """Noise sd of each column (T, C) from its differences, robustly; 0 where too little is seen.

    Rows without a value are passed over: a recording may have commands, and nothing else, in most of them.
    """
    return point_jitter(columns[..., None])


def point_jitter(points: np.ndarray) -> np.ndarray:
    """Noise sd of an axis of each of points (T, P, d), (P,), whichever way the axes are turned; see :func:`jitter`."""
    return np.array([robust_sd(differences(seen_vectors(point))) for point in points.swapaxes(0, 1)])


def robust_sd(vectors: np.ndarray) -> float:
    """Sd of an axis of Gaussian vectors (n, d) about 0, from their median length; 0 of none."""
    if not len(vectors):
        return 0.0
    return float(np.median(np.linalg.norm(vectors, axis=-1)) / math.sqrt(chi2.median(vectors.shape[-1])))


def seen_vectors(vectors: np.ndarray) -> np.ndarray:
    """Rows of vectors (T, d) that are seen whole; without axes that are seen in less than half of the best one's."""
    seen = np.isfinite(vectors).sum(0)
    used = vectors[:, 2 * seen >= seen.max()]
    return used[np.isfinite(used).all(-1)]


def differences(vectors: np.ndarray) -> np.ndarray:
    """n-th differences of vectors (T, d), (T − n, d), as large as the noise in them; none of too few rows.

    Those of white noise have √(2n choose n) times its sd, whatever n, by which they are divided; what a fast arm adds
    to them falls with n, so that the order with the least of them counts. Of a very fast one it falls beyond ``ORDERS``
    still: higher ones follow while each has surely less, by ``SURELY`` standard deviations of a median's logarithm.
    """

    def scaled(n: int) -> np.ndarray:
        return np.diff(vectors, n=n, axis=0) / math.sqrt(math.comb(2 * n, n))

    orders = [n for n in ORDERS if len(vectors) > n]
    found = min((scaled(n) for n in orders), key=robust_sd, default=vectors[:0])
    for higher in (scaled(n) for n in HIGHER if len(vectors) > 2 * n):
        ratio = math.exp(-SURELY * math.sqrt(MEDIAN / len(higher)))
        if not robust_sd(higher) < ratio * robust_sd(found):
            break
        found = higher
    return found
