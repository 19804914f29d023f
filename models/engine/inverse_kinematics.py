"""Configurations that explain each row by itself: where an engine's paths begin.

Row after row, each from the one before, by the sensors' own means h (:func:`..inverse_kinematics.fitted_poses`):

    δ_t = argmin Σ_o ((y_o − h_o(δ)) / σ_o)² + |(δ − δ_{t−1}) / s|²

Entries that were not seen drop out, and coordinates that no row shows stay where they were. Velocities are slopes of a
smoothed path (A. Savitzky & M. J. E. Golay, Analytical Chemistry 36, 1964).

Shapes: rows (T, O), δ (nv,), paths (T, D).
"""

import numpy as np
from scipy.signal import savgol_filter

from invdyn.models.inverse_kinematics import Seen, fitted_poses

STEPS, LEAST_GAIN = 20, 1e-6  # of a row's search, which begins at the row before, and by which its cost falls
STARTS = 12
"""Configurations tried for the first row that shows anything."""
WINDOW, ORDER = 9, 3  # rows and order of the Savitzky–Golay filter of velocities


def poses(seen: Seen, noise: np.ndarray, rows: np.ndarray, time: np.ndarray, nv: int) -> tuple[np.ndarray, np.ndarray]:
    """Configurations δ and velocities, (T, nv) each, that ``rows`` (T, O) with ``noise`` (O,) show at times (T,) s."""
    tangent = np.zeros((len(rows), nv))
    first = int(np.argmax(np.isfinite(rows).any(1)))
    starts = np.random.default_rng(0).uniform(-1.0, 1.0, (STARTS, nv))
    starts[0] = 0
    found, cost = fitted_poses(rows[first], seen, noise, starts, starts, least_gain=LEAST_GAIN)
    here = found[cost <= cost.min() + 1.0][:1]  # of equals that which is nearest to the file's own pose
    for t in range(first, len(rows)):
        if np.isfinite(rows[t]).any():
            here, _ = fitted_poses(rows[t], seen, noise, here, here, STEPS, LEAST_GAIN)
        tangent[t] = here[0]
    tangent[:first] = tangent[first]
    window = min(WINDOW, len(rows) - (len(rows) + 1) % 2)
    if window > ORDER:
        tangent = savgol_filter(tangent, window, ORDER, axis=0)
    return tangent, np.asarray(np.gradient(tangent, time, axis=0))
