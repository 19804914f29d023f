"""Configurations that explain each row by itself: where an engine's paths begin.

Levenberg–Marquardt on the sensors' own means h, row after row, each from the one before:

    δ_t = argmin Σ_o ((y_o − h_o(δ)) / σ_o)² + |(δ − δ_{t−1}) / s|²,

with slopes by differences. Entries that were not seen drop out, and coordinates that no row shows stay where they
were. Velocities are slopes of a smoothed path (A. Savitzky & M. J. E. Golay, Analytical Chemistry 36, 1964).

Shapes: rows (T, O), δ (nv,), paths (T, D).
"""

from collections.abc import Mapping
from typing import Protocol

import numpy as np
import torch
from pyro.distributions import Distribution
from scipy.signal import savgol_filter
from torch import Tensor

TIE = 10.0
"""s, rad or m: how far a configuration may be from that of the row before; next to nothing against what is seen."""
NUDGE, ROUNDS, FIRST_ROUNDS = 1e-5, 8, 40  # of slopes; steps of a search, and of the first row
STARTS = 12
"""Configurations tried for the first row that shows anything."""
WINDOW, ORDER = 9, 3  # rows and order of the Savitzky–Golay filter of velocities


class Posed(Protocol):
    """What is needed of a model: sizes of its state (z, δ, v, a), and what its sensors show of one."""

    nv: int
    na: int
    torque_size: int
    state_dim: int
    observation_dim: int

    @property
    def parameters(self) -> Mapping[str, Tensor]:
        """By dotted name."""

    @property
    def time(self) -> Tensor:
        """(T,) s."""

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of a row, whose location and scale are known."""


def poses(model: Posed, rows: np.ndarray) -> np.ndarray:
    """A path (T, D) with no drive, middle activations, and the configurations and velocities that ``rows`` show."""
    nv, z = model.nv, model.torque_size
    tangent = np.zeros((len(rows), nv))
    first = int(np.argmax(np.isfinite(rows).any(1)))
    here = _first(model, rows[first])
    for t in range(first, len(rows)):
        if np.isfinite(rows[t]).any():
            here = _solved(model, rows[t], here[None], ROUNDS)[0][0]
        tangent[t] = here
    tangent[:first] = tangent[first]
    window = min(WINDOW, len(rows) - (len(rows) + 1) % 2)
    path = np.zeros((len(rows), model.state_dim))
    time = model.time.numpy()
    if window > ORDER:
        tangent = savgol_filter(tangent, window, ORDER, axis=0)
    path[:, z : z + nv] = tangent
    path[:, z + nv : z + 2 * nv] = np.gradient(tangent, time, axis=0)
    if model.na:
        path[:, z + 2 * nv :] = model.parameters["initial.activation"].detach().reshape(-1, model.na)[0].numpy()
    return path


def _first(model: Posed, row: np.ndarray) -> np.ndarray:
    """The best of several starts: the reference, and others around it."""
    rng = np.random.default_rng(0)
    starts = rng.uniform(-1.0, 1.0, (STARTS, model.nv))
    starts[0] = 0
    found, merit = _solved(model, row, starts, FIRST_ROUNDS)
    near = merit <= merit.min() + 1.0
    return found[np.flatnonzero(near)[0]]  # of equals that which is nearest to the file's own pose


def _solved(model: Posed, row: np.ndarray, start: np.ndarray, rounds: int) -> tuple[np.ndarray, np.ndarray]:
    """From several starts (B, nv): where the search ends, and the merits (B,)."""
    nv, size = model.nv, model.observation_dim
    seen = np.isfinite(row)
    here, damping = start.copy(), np.full(len(start), 1e-3)

    def means(tangent: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        state = np.zeros((*tangent.shape[:-1], model.state_dim))
        state[..., model.torque_size : model.torque_size + nv] = tangent
        emission = model.emission(torch.as_tensor(state), 0)
        base = getattr(emission, "base_dist", emission)
        return base.loc.numpy()[..., seen], np.broadcast_to(base.scale.numpy(), (*state.shape[:-1], size))[..., seen]

    def misfit(tangent: np.ndarray) -> np.ndarray:
        mean, sd = means(tangent)
        return (row[seen] - mean) / sd

    off = misfit(here)
    merit = (off**2).sum(-1)
    for _ in range(rounds):
        nudged = here[:, None] + NUDGE * np.eye(nv)
        slope = (misfit(nudged) - off[:, None]) / NUDGE  # (B, nv, o)
        normal = slope @ slope.swapaxes(-1, -2) + np.eye(nv) / TIE**2
        diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
        step = -np.linalg.solve(
            normal + damping[:, None, None] * np.eye(nv) * diagonal[:, None], (slope @ off[..., None])
        )[..., 0]
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
