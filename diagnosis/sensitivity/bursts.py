"""What a burst of torque in each stretch of time would explain of whitened data, in time linear in the rows.

A burst is an input g_t into the state while it lasts, and nothing before. In the recursion of :mod:`.innovations`, with
B_t = −W_t E_t and C_t = F_t − K_t E_t, it changes

    w_t = B_t m_t,    m_{t+1} = C_t m_t + g_t,    m = 0 where it begins,

and once it is over, at row s, what it still does to all later rows follows from m_s by two backward passes, once for
all bursts (the observability Gramian, Anderson & Moore 1979, ch. 5, and the data's adjoint):

    P_t = B_tᵀ B_t + C_tᵀ P_{t+1} C_t,     Σ_{t≥s} w_tᵀ w_t = m_sᵀ P_s m_s
    λ_t = B_tᵀ w⁰_t + C_tᵀ λ_{t+1},        Σ_{t≥s} w_tᵀ w⁰_t = m_sᵀ λ_s.

Shapes: T rows, D states, O observations, K joints, W bursts, G noise levels.
"""

from collections.abc import Sequence

import numpy as np

from invdyn.diagnosis.sensitivity.innovations import innovations
from invdyn.diagnosis.sensitivity.whiten import Filter


def burst_products(
    about: Filter, response: np.ndarray, time: np.ndarray, stretches: Sequence[tuple[float, float]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of bursts' whitened changes: with each other (G, W, K, K), with the data (G, W, K), and data's (G,).

    Args:
        about: the filter.
        response: (T−1, D, K) what a unit torque on a joint during a row makes of the next state.
        time: (T,) s.
        stretches: W of them, s: a constant torque on each joint while it lasts.
    """
    E, F, gained = about.linear.E, about.linear.F, about.gained
    T, seen = E.shape[:2]
    linear, nothing = about.linear, (np.zeros((T - 1, F.shape[-1], 0)), np.zeros((T, seen, 0)))
    data = innovations(gained, F, linear.a, E, linear.e, linear.m0, *nothing)[..., 0].reshape(-1, T, seen)
    B = -gained.whitening @ E[:, None]  # (T, G, O, D)
    C = F[:, None] - gained.gain @ E[:-1, None]  # (T−1, G, D, D)
    energy, adjoint = _later(B, C, data)

    starts, stops = np.array(stretches).T
    first = np.clip(np.searchsorted(time, starts, side="right") - 1, 0, T - 2)
    length = int((np.searchsorted(time[:-1], stops) - first).max())
    first = np.minimum(first, T - 1 - length)  # an earlier row than the burst's does nothing
    G, D, K = len(data), F.shape[-1], response.shape[-1]
    m = np.zeros((len(first), G, D, K))
    own, with_data = np.zeros((len(first), G, K, K)), np.zeros((len(first), G, K))
    for step in range(length):
        t = first + step
        w = B[t] @ m
        own += w.swapaxes(-1, -2) @ w
        with_data += np.einsum("wgok,gwo->wgk", w, data[:, t])
        low, high = time[t], time[t + 1]
        lasts = np.clip((np.minimum(high, stops) - np.maximum(low, starts)) / (high - low), 0, 1)
        m = C[t] @ m + (lasts[:, None, None] * response[t])[:, None]
    t = first + length
    own += m.swapaxes(-1, -2) @ energy[t] @ m
    with_data += np.einsum("wgdk,wgd->wgk", m, adjoint[t])
    return own.swapaxes(0, 1), with_data.swapaxes(0, 1), (data**2).sum((1, 2))


def _later(B: np.ndarray, C: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P (T, G, D, D) and λ (T, G, D)."""
    T, G, _, D = B.shape
    energy, adjoint = np.empty((T, G, D, D)), np.empty((T, G, D))
    seen = B.swapaxes(-1, -2)
    own = seen @ B
    mine = np.einsum("tgdo,gto->tgd", seen, data)
    energy[-1], adjoint[-1] = own[-1], mine[-1]
    for t in range(T - 2, -1, -1):
        back = C[t].swapaxes(-1, -2)
        energy[t] = own[t] + back @ energy[t + 1] @ C[t]
        adjoint[t] = mine[t] + (back @ adjoint[t + 1][..., None])[..., 0]
    return energy, adjoint
