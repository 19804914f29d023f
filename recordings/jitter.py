"""The noise of what was recorded, from what a smooth motion cannot explain: differences of a high order.

The noise of a point in d dimensions is the largest along its principal axes, 1.4826 times the median absolute value.
So it does not depend on how the recording's axes are rotated. The principal axes are those of the vectors' directions,
which far ones do not sway:

    S = Σ_i v_i v_iᵀ / |v_i|²,   σ = max over eigenvectors u of S of 1.4826 median |uᵀ v_i|

(Visuri, Koivunen & Oja 2000, "Sign and rank covariance matrices", J. Statist. Plann. Inference 91, 557–575).

Shapes: columns (T, C) of C numbers in T rows; points (T, P, d). NaN where missing.
"""

import math

import numpy as np

ORDERS, HIGHER = (3, 4, 5), (10, 15)
"""Of the differences that noise is estimated from, and of those that a very fast motion needs."""
SIGNIFICANT = 3.0
"""Standard deviations by which a higher order must show less."""
MEDIAN = 1.36
"""n times the relative variance of the median of the sizes of n Gaussians."""


def jitter(columns: np.ndarray) -> np.ndarray:
    """Noise sd of each column (T, C) from its differences, robustly; 0 where too little is seen.

    Rows without a value are passed over: a recording may have commands, and nothing else, in most of them.
    """
    return point_jitter(columns[..., None])


def point_jitter(points: np.ndarray) -> np.ndarray:
    """Noise sd of points (T, P, d), (P,), for any rotation of the axes; see :func:`jitter`."""
    return np.array([robust_sd(differences(seen_vectors(point))) for point in points.swapaxes(0, 1)])


def robust_sd(vectors: np.ndarray) -> float:
    """Sd of vectors (n, d) about 0 along the principal axis that has most; see the top of the file. 0 of none."""
    if not len(vectors):
        return 0.0
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    signs = vectors / np.where(lengths > 0, lengths, 1.0)
    _, axes = np.linalg.eigh(signs.T @ signs)
    return float(1.4826 * np.median(np.abs(vectors @ axes), axis=0).max())


def seen_vectors(vectors: np.ndarray) -> np.ndarray:
    """Rows of vectors (T, d) that are seen whole, without axes that are seen in less than half as many as the best."""
    seen = np.isfinite(vectors).sum(0)
    used = vectors[:, 2 * seen >= seen.max()]
    return used[np.isfinite(used).all(-1)]


def differences(vectors: np.ndarray) -> np.ndarray:
    """n-th differences of vectors (T, d), (T − n, d), as large as the noise in them; none of too few rows.

    Those of white noise have √(2n choose n) times its sd, for any n, by which they are divided; what a fast arm adds
    to them falls with n, so that the order with the least of them counts. Of a very fast one it falls beyond ``ORDERS``
    still: higher ones follow while each has significantly less, by ``SIGNIFICANT`` standard deviations of a
    median's logarithm.
    """

    def scaled(n: int) -> np.ndarray:
        return np.diff(vectors, n=n, axis=0) / math.sqrt(math.comb(2 * n, n))

    orders = [n for n in ORDERS if len(vectors) > n]
    found = min((scaled(n) for n in orders), key=robust_sd, default=vectors[:0])
    for higher in (scaled(n) for n in HIGHER if len(vectors) > 2 * n):
        ratio = math.exp(-SIGNIFICANT * math.sqrt(MEDIAN / len(higher)))
        if not robust_sd(higher) < ratio * robust_sd(found):
            break
        found = higher
    return found
