"""Smoothing by local polynomials, against scipy's Savitzky–Golay filter."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from invdyn.models.local_polynomial import local_polynomial


@pytest.mark.parametrize(("window", "degree", "derivative"), [(7, 3, 0), (9, 2, 1), (97, 3, 2), (5, 4, 3), (101, 3, 1)])
def test_it_is_the_savitzky_golay_filter_at_all_rows(window, degree, derivative):
    rows = np.random.default_rng(0).normal(size=(101, 2)).cumsum(0)
    found = local_polynomial(rows, window, degree, derivative, 0.01)
    expected = savgol_filter(rows, window, degree, deriv=derivative, delta=0.01, axis=0)
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
