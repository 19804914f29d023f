"""The noise of what was recorded, from what a smooth motion cannot explain: differences of a high order.

Shapes: columns (T, C) of C numbers in T rows, NaN where missing.
"""

import math

import numpy as np

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
    found = [differences(column[np.isfinite(column)]) for column in columns.T]
    return np.array([1.4826 * np.median(np.abs(each)) if len(each) else 0.0 for each in found])


def differences(column: np.ndarray) -> np.ndarray:
    """n-th differences of values (T,), (T − n,), as large as the noise in them; none of too few values.

    Those of white noise have √(2n choose n) times its sd, whatever n, by which they are divided; what a fast arm adds
    to them falls with n, so that the order with the least of them counts. Of a very fast one it falls beyond ``ORDERS``
    still: higher ones follow while each has surely less, by ``SURELY`` standard deviations of a median's logarithm.
    """

    def scaled(n: int) -> np.ndarray:
        return np.diff(column, n=n) / math.sqrt(math.comb(2 * n, n))

    orders = [n for n in ORDERS if len(column) > n]
    found = min((scaled(n) for n in orders), key=lambda each: np.median(np.abs(each)), default=np.empty(0))
    for higher in (scaled(n) for n in HIGHER if len(column) > 2 * n):
        ratio = math.exp(-SURELY * math.sqrt(MEDIAN / len(higher)))
        if not np.median(np.abs(higher)) < ratio * np.median(np.abs(found)):
            break
        found = higher
    return found
