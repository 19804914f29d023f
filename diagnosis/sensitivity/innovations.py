"""Whitened innovations of a linear-Gaussian chain, and what any input would change in them.

The Kalman filter turns observations into independent unit Gaussians w_t = S_t^{-1/2} (y_t − ŷ_t). It is linear: an
input of unit size into the state (g_t) or into what is seen (d_t) changes w by a column that the same filter, with
the same gains, makes of the input alone. So the gains, which are costly, are found once, and one pass whitens the data
and every candidate's input together; what follows is least squares on columns (Anderson & Moore 1979, ch. 5;
Willsky & Jones 1976, "A generalized likelihood ratio approach to the detection and estimation of jumps").

    x_{t+1} = F_t x_t + a_t + Σ_j φ_j g_{t,j} + noise Q_t,    E_t x_t ≈ e_t − Σ_j φ_j d_{t,j}  with unit noise

    w(φ) = w_0 + Σ_j φ_j w_j ,     log p(e | φ) = −½ |w(φ)|² − Σ_t ½ log |S_t| + const

With W_t = S_t^{-1/2} and K_t = F_t P_t E_tᵀ S_t^{-1}, predictions m_t of all columns follow one recursion:

    w_t = W_t (e_t − E_t m_t),    m_{t+1} = (F_t − K_t E_t) m_t + K_t e_t + a_t

Shapes: T rows, D states, O observations, J inputs, G noise levels at once (Q has a leading dimension G).
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Gains:
    """A Kalman filter's, which do not depend on what is seen.

    Attributes:
        whitening: (T, G, O, O) S_t^{-1/2}.
        gain: (T − 1, G, D, O) K_t.
        log_det: (G, T) ½ log |S_t|.
    """

    whitening: np.ndarray
    gain: np.ndarray
    log_det: np.ndarray


def gains(F: np.ndarray, Q: np.ndarray, E: np.ndarray, P0: np.ndarray) -> Gains:
    """Of F (T−1, D, D), Q (G, T−1, D, D), E (T, O, D) whitened rows, zero where missing, and P0 (G, D, D)."""
    steps, rows, dim = E.shape
    expected = np.empty((steps, len(Q), rows, rows))  # S_t
    towards = np.empty((steps - 1, len(Q), rows, dim))  # S_t^{-1} E_t P_t
    P, eye = P0, np.eye(rows)
    for t in range(steps):
        HP = E[t] @ P
        expected[t] = HP @ E[t].T + eye
        if t == steps - 1:
            break
        towards[t] = np.linalg.solve(expected[t], HP)
        P = F[t] @ (P - HP.swapaxes(-1, -2) @ towards[t]) @ F[t].T + Q[:, t]
        P = (P + P.swapaxes(-1, -2)) / 2
    root = np.linalg.cholesky(expected)
    log_det = np.log(np.diagonal(root, axis1=-2, axis2=-1)).sum(-1).T
    return Gains(np.linalg.inv(root), F[:, None] @ towards.swapaxes(-1, -2), log_det)


@np.errstate(over="ignore", invalid="ignore")  # A column that runs away is one that :mod:`.evidence` leaves out.
def innovations(
    gained: Gains,
    F: np.ndarray,
    a: np.ndarray,
    E: np.ndarray,
    e: np.ndarray,
    m0: np.ndarray,
    g: np.ndarray,
    d: np.ndarray,
) -> np.ndarray:
    """Columns (G, T·O, 1 + J): the data's, whitened, then each input's.

    Args:
        gained: what :func:`gains` makes of F and E.
        F, a: (T−1, D, D), (T−1, D).
        E, e: (T, O, D), (T, O) whitened rows, zero where missing.
        m0: (D,).
        g: (T−1, D, J).
        d: (T, O, J), whitened as e is.
    """
    G, steps, rows, inputs = gained.whitening.shape[1], E.shape[0], E.shape[1], g.shape[-1]
    dim = E.shape[-1]
    given = np.concatenate([e[..., None], -d], -1)
    driven = np.concatenate([a[..., None], g], -1)
    # What a row adds to its innovations and to the next prediction, of all levels at once, and what a prediction does.
    onto = np.concatenate([gained.whitening[:-1], gained.gain], -2)
    moving = np.concatenate([-gained.whitening[:-1] @ E[:-1, None], F[:, None] - gained.gain @ E[:-1, None]], -2)
    columns = np.empty((G, steps, rows, 1 + inputs))
    mean = np.zeros((G, dim, 1 + inputs))
    mean[:, :, 0] = m0
    for t in range(steps - 1):
        both = moving[t] @ mean
        both += (onto[t].reshape(-1, rows) @ given[t]).reshape(both.shape)
        columns[:, t] = both[:, :rows]
        mean = both[:, rows:] + driven[t]
    columns[:, -1] = gained.whitening[-1] @ (given[-1] - E[-1] @ mean)
    return columns.reshape(G, steps * rows, 1 + inputs)
