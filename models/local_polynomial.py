"""Derivatives of noisy rows: of the polynomial that fits a window of them best, at the window's middle.

    c = argmin |P c − rows|²,   P_ik = x_i^k,   x_i = (i − h)/h,      d^n/dt^n Σ c_k x^k   at x = 0

of a window of W = 2h + 1 rows (Savitzky & Golay, "Smoothing and differentiation of data by simplified least squares
procedures", Analytical Chemistry 36, 1964). The first and last h rows are of the first and last window's polynomial.
It is `scipy.signal.savgol_filter` without the second that scipy.signal takes to import.
"""

import numpy as np


def local_polynomial(rows: np.ndarray, window: int, degree: int, derivative: int = 0, step: float = 1.0) -> np.ndarray:
    """Smoothed ``rows`` (T, K), ``step`` s apart, or a derivative, per s to the power of its order.

    The ``window`` is an odd number of rows, 3 or more and no more than T, and more than ``degree``.
    """
    half = window // 2
    powers = np.vander((np.arange(window) - half) / half, degree + 1, increasing=True)
    slope = np.linalg.matrix_power(np.diag(np.arange(1.0, degree + 1), 1), derivative)  # of coefficients
    weights = powers @ slope @ np.linalg.pinv(powers) / (half * step) ** derivative
    middle = np.lib.stride_tricks.sliding_window_view(rows, window, axis=0) @ weights[half]
    return np.concatenate([weights[:half] @ rows[:window], middle, weights[half + 1 :] @ rows[-window:]])
