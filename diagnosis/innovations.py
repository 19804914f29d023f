"""Whitened innovations of a linear-Gaussian chain, and what any input would change in them.

The Kalman filter turns observations into independent unit Gaussians w_t = S_t^{-1/2} (y_t − ŷ_t). It is linear: an
input of unit size into the state (g_t) or into what is seen (d_t) changes w by a column that the same filter, with
the same gains, makes of the input alone. So one pass whitens the data and every candidate's input together, and
whatever follows is least squares on columns (Anderson & Moore 1979, ch. 5; Willsky & Jones 1976, "A generalized
likelihood ratio approach to the detection and estimation of jumps").

    x_{t+1} = F_t x_t + a_t + Σ_j φ_j g_{t,j} + noise Q_t,    E_t x_t ≈ e_t − Σ_j φ_j d_{t,j}  with unit noise

    w(φ) = w_0 + Σ_j φ_j w_j ,     log p(e | φ) = −½ |w(φ)|² − Σ_t ½ log |S_t| + const

Shapes: T rows, D states, O observations, J inputs, G noise levels at once (Q has a leading dimension G).
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Innovations:
    """Result of :func:`innovations`.

    Attributes:
        columns: (G, T·O, 1 + J) whitened: the data's w_0, then each input's.
        log_det: (G, T) ½ log |S_t|.
    """

    columns: np.ndarray
    log_det: np.ndarray


def innovations(
    F: np.ndarray,
    a: np.ndarray,
    Q: np.ndarray,
    E: np.ndarray,
    e: np.ndarray,
    m0: np.ndarray,
    P0: np.ndarray,
    g: np.ndarray,
    d: np.ndarray,
) -> Innovations:
    """Filter the data and all inputs.

    Args:
        F, a: (T−1, D, D), (T−1, D).
        Q: (G, T−1, D, D).
        E, e: (T, O, D), (T, O) whitened rows, zero where missing.
        m0, P0: (D,), (G, D, D).
        g: (T−1, D, J).
        d: (T, O, J), whitened as e is.
    """
    G, steps, rows, inputs = len(Q), E.shape[0], E.shape[1], g.shape[-1]
    dim = E.shape[-1]
    columns = np.empty((G, steps, rows, 1 + inputs))
    roots = np.empty((G, steps, rows, rows))
    mean = np.zeros((G, dim, 1 + inputs))
    mean[:, :, 0] = m0
    P = P0.copy()
    eye = np.eye(rows)
    given = np.concatenate([e[..., None], -d], -1)
    driven = np.concatenate([a[..., None], g], -1)
    for t in range(steps):
        H = E[t]
        PH = P @ H.T
        S = H @ PH + eye
        root = np.linalg.cholesky(S)
        inverse = np.linalg.inv(root)
        white = inverse @ (given[t] - H @ mean)
        gain = PH @ np.swapaxes(inverse, -1, -2)  # P Hᵀ S^{-T/2}
        columns[:, t] = white
        roots[:, t] = root
        if t == steps - 1:
            break
        mean = F[t] @ (mean + gain @ white) + driven[t]
        P = F[t] @ (P - gain @ np.swapaxes(gain, -1, -2)) @ F[t].T + Q[:, t]
        P = (P + np.swapaxes(P, -1, -2)) / 2
    log_det = np.log(np.diagonal(roots, axis1=-2, axis2=-1)).sum(-1)
    return Innovations(columns.reshape(G, steps * rows, 1 + inputs), log_det)
