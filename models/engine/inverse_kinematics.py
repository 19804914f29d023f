"""Configurations that explain each row by itself: where an engine's paths begin.

Levenberg–Marquardt on the sensors' own means h, row after row, each from the one before:

    δ_t = argmin Σ_o ((y_o − h_o(δ)) / σ_o)² + |(δ − δ_{t−1}) / s|²,

with slopes by differences. Entries that were not seen drop out, and coordinates that no row shows stay where they
were. Velocities are slopes of a smoothed path (A. Savitzky & M. J. E. Golay, Analytical Chemistry 36, 1964).

Shapes: rows (T, O), δ (nv,), paths (T, D).
"""

from collections.abc import Callable

import numpy as np
from scipy.signal import savgol_filter

TIE = 10.0
"""s, rad or m: how far a configuration may be from that of the row before; next to nothing against what is seen."""
NUDGE, ROUNDS, FIRST_ROUNDS = 1e-5, 8, 40  # of slopes; steps of a search, and of the first row
STARTS = 12
"""Configurations tried for the first row that shows anything."""
WINDOW, ORDER = 9, 3  # rows and order of the Savitzky–Golay filter of velocities


Means = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Of δ (…, nv) what sensors show, and their noise, (…, O) each."""


def poses(means: Means, rows: np.ndarray, time: np.ndarray, nv: int) -> tuple[np.ndarray, np.ndarray]:
    """Configurations δ and velocities, (T, nv) each, that ``rows`` (T, O) show at ``time`` (T,) s."""
    tangent = np.zeros((len(rows), nv))
    first = int(np.argmax(np.isfinite(rows).any(1)))
    here = _first(means, rows[first], nv)
    for t in range(first, len(rows)):
        if np.isfinite(rows[t]).any():
            here = _solved(means, rows[t], here[None], ROUNDS)[0][0]
        tangent[t] = here
    tangent[:first] = tangent[first]
    window = min(WINDOW, len(rows) - (len(rows) + 1) % 2)
    if window > ORDER:
        tangent = savgol_filter(tangent, window, ORDER, axis=0)
    return tangent, np.asarray(np.gradient(tangent, time, axis=0))


def _first(means: Means, row: np.ndarray, nv: int) -> np.ndarray:
    """The best of several starts: the reference, and others around it."""
    starts = np.random.default_rng(0).uniform(-1.0, 1.0, (STARTS, nv))
    starts[0] = 0
    found, merit = _solved(means, row, starts, FIRST_ROUNDS)
    near = merit <= merit.min() + 1.0
    return found[np.flatnonzero(near)[0]]  # of equals that which is nearest to the file's own pose


def _solved(means: Means, row: np.ndarray, start: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """From several starts (B, nv): where the search ends, and the merits (B,)."""
    eye, seen = np.eye(start.shape[-1]), np.isfinite(row)
    here, damping = start.copy(), np.full(len(start), 1e-3)

    def misfit(tangent: np.ndarray) -> np.ndarray:
        mean, sd = means(tangent)
        return ((row - mean) / sd)[..., seen]

    off = misfit(here)
    merit = (off**2).sum(-1)
    for _ in range(rounds):
        nudged = here[:, None] + NUDGE * eye
        slope = (misfit(nudged) - off[:, None]) / NUDGE  # (B, nv, o)
        normal = slope @ slope.swapaxes(-1, -2) + eye / TIE**2
        normal += damping[:, None, None] * eye * np.diagonal(normal, axis1=-2, axis2=-1)[:, None]
        step = -np.linalg.solve(normal, slope @ off[..., None])[..., 0]
        step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(-1, keepdims=True), 1e-12))
        tried = misfit(here + step)
        reached = (tried**2).sum(-1)
        better = reached < merit
        gain = np.where(better, merit - reached, 0.0)
        here = np.where(better[:, None], here + step, here)
        off = np.where(better[:, None], tried, off)
        merit = np.where(better, reached, merit)
        damping = np.where(better, damping / 5, damping * 5)
        if ((gain < 1e-3).all() and (damping > 1).all()) or (better & (gain < 1e-3)).all():
            break
    return here, merit
