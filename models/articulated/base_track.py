"""The path of a base from its own track alone: a Kalman filter and Rauch, Tung and Striebel's smoother, axis by axis.

    y_t = b_t + N(0, r²),   b as in :mod:`.moving_base`

No body is needed for it, so that it serves as a start, and tells whether a base moves at all. Detections far off their
neighbours, which least squares would follow, are left out first (F. R. Hampel, "The influence curve and its role in
robust estimation", Journal of the American Statistical Association 69 (1974), 383–393).

Shapes: T rows, d axes, n states an axis; leading dimensions (...) are many parameter sets.
"""

import math
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from invdyn.models.articulated.moving_base import ORDER, MovingBase
from invdyn.models.shapes import common

PAIRS, WINDOW, OUTLIER_SDS = 3, 7, 6.0
"""Pairs of rows about one whose middles tell where it should be; rows about it that tell how well they do; and how many
deviations off it is left out."""
GRAIN = 64
"""Parts of the median step that times of rows are rounded to."""


def without_outliers(track: np.ndarray, noise: float) -> np.ndarray:
    """A track (T, d) with detections that are far off their neighbours missing, of a tracker's ``noise`` sd."""
    near = _windows(track, PAIRS)
    off = track - _nanmedian((near[..., :PAIRS] + near[..., :PAIRS:-1]) / 2)
    sd = noise + 1.4826 * _nanmedian(np.abs(_windows(off, WINDOW)))
    far = (np.abs(off) > OUTLIER_SDS * sd).any(-1)
    return np.where(far[:, None], np.nan, track)


def _windows(values: np.ndarray, rows: int) -> np.ndarray:
    """Of values (T, d) those in so many rows before and after each, (T, d, 2 rows + 1); NaN beyond the ends."""
    padded = np.pad(values, ((rows, rows), (0, 0)), constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * rows + 1, axis=0)


def _nanmedian(values: np.ndarray) -> np.ndarray:
    """Along the last axis, NaN of nothing."""
    known = np.isfinite(values).any(-1)
    return np.where(known, np.nanmedian(np.where(known[..., None], values, 0.0), axis=-1), np.nan)


def filtered(
    base: MovingBase,
    parameters: Mapping[str, Tensor],
    time: np.ndarray,
    track: np.ndarray,
    noise: Tensor,
    smooth: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Log-evidence (..., d), nats, of a track (T, d) with noise sd (..., d), and the states (..., T, 4 d).

    They are smoothed, or, without ``smooth``, none.
    """
    dt = np.diff(time)
    unit = np.median(dt) / GRAIN  # clocks jitter: steps that differ by less are one
    dt = np.maximum(np.round(dt / unit), 1) * unit
    step: dict[float, tuple[np.ndarray, np.ndarray]] = {}
    for each in np.unique(dt).tolist():
        over = torch.tensor([each], dtype=torch.float64)
        root = base.noise_blocks(over, parameters)
        step[each] = base.propagator(over, parameters).numpy(), (root @ root.mT).numpy()
    sd = base.initial_sd(parameters)
    batch = common(sd.shape[:-1], noise.shape)
    mean = np.zeros((*batch, ORDER))
    cov = torch.diag_embed(sd**2).expand(*batch, ORDER, ORDER).numpy()
    r2, evidence = noise.expand(batch).numpy() ** 2, np.zeros(batch)
    ahead, behind = [], []
    for t, row in enumerate(track):
        if t:
            F, Q = step[float(dt[t - 1])]
            mean, cov = (F @ mean[..., None])[..., 0], F @ cov @ F.swapaxes(-1, -2) + Q
        ahead.append((mean, cov))
        seen = np.isfinite(row)
        off = np.where(seen, row - mean[..., 0], 0.0)
        variance = cov[..., 0, 0] + r2
        gain = np.where(seen[..., None], cov[..., 0] / variance[..., None], 0.0)
        evidence = evidence - 0.5 * np.where(seen, off**2 / variance + np.log(2 * math.pi * variance), 0.0)
        mean = mean + gain * off[..., None]
        cov = cov - gain[..., :, None] * cov[..., None, 0, :]
        behind.append((mean, cov))
    if not smooth:
        return evidence, np.empty((*batch[:-1], 0, base.size))
    path = [behind[-1][0]]
    for t in range(len(track) - 1, 0, -1):
        F, _ = step[float(dt[t - 1])]
        cross = behind[t - 1][1] @ F.swapaxes(-1, -2)
        back = np.linalg.solve(ahead[t][1], cross.swapaxes(-1, -2)).swapaxes(-1, -2)
        path.append(behind[t - 1][0] + (back @ (path[-1] - ahead[t][0])[..., None])[..., 0])
    states = np.stack(path[::-1], axis=-3)  # (..., T, d, 4)
    return evidence, states.swapaxes(-1, -2).reshape(*states.shape[:-2], -1)


def smoothed(
    base: MovingBase, parameters: Mapping[str, Tensor], time: np.ndarray, track: np.ndarray, noise: float
) -> np.ndarray:
    """Smoothed states (T, 4 d) of a track (T, d) with one set of parameters."""
    own = {name: value.detach().cpu().double() for name, value in parameters.items() if name.startswith("base.")}
    sd = torch.full((base.axes,), float(noise), dtype=torch.float64)
    return filtered(base, own, time, without_outliers(track, noise), sd)[1]
