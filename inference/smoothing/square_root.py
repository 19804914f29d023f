"""Square-root information recursions on a linear-Gaussian chain.

Paige & Saunders (1977), "Least squares estimation of discrete linear dynamic systems using
orthogonal transformations"; Bierman (1977), ch. VI. The chain is

    x_0 = m_0 + L_0 w_0,
    m_{t+1} = F_t x_t + a_t + V_t v_t,   x_{t+1} = m_{t+1} + L_{t+1} w_{t+1},   v, w ~ N(0, I),
    rows  E_t x_t ≈ e_t  with unit noise  (whitened observations).

L is the model's own noise; V, optional, is the error of having linearised the prediction m.

Backwards in time, everything that rows t … T−1 say about x_t is one Gaussian factor
ψ_t(x) = exp(c_t − ½|U_t x − b_t|²). One step is one QR decomposition, with N Nᵀ = L Lᵀ + V Vᵀ of
row t + 1, and U and b of that row on the left. It eliminates the noise u of x_{t+1} = F x_t + a + N u,
and folds in the rows E_t:

    [ I      0     | 0       ]        [ R   · | · ]
    [ U N    U F   | b − U a ]  =  Q  [ 0   U | b ]      (columns: u, x_t | right-hand side)
    [ 0      E     | e       ]        [ 0   0 | ρ ]

    c_t = c_{t+1} − log |det R| − ½ ρ²

What else is needed of the factors is then computed for all rows at once. The noise w given the prediction m:

    [ I        0        | 0 ]        [ R   B | r ]
    [ U L      U        | b ]  =  Q  [ 0   A | α ]      (columns: w, m | right-hand side)

    ∫ N(x'; m, L Lᵀ) ψ(x') dx' = exp(c − ½|A m − α|²) / |det R|
    w given m  ~  N(R⁻¹(r − B m), (RᵀR)⁻¹)

and the error v of the prediction given x_t:

    [ I      0     | 0       ]        [ S   C | s ]
    [ A V    A F   | α − A a ]  =  Q  [ 0   · | · ]      (columns: v, x_t | right-hand side)

Nothing is squared and nothing inverted but R and S, whose singular values are ≥ 1: L may be
singular, observations as sharp as you like, and T as long as you like.

Shapes: numpy float64 with any leading batch (…): F (…, T−1, D, D), a (…, T−1, D), L (…, T, D, D),
V (…, T−1, D, J), E (…, T, O, D), e (…, T, O), m_0 (…, D). Coordinates may be deviations from a path.
"""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg.lapack import dgeqrf

ROWS_AT_ONCE = 1024
"""Rows whose transitions are prepared at once."""


@dataclass
class BackwardFactors:
    """All ψ_t, and what a forward pass needs; see the top of the file.

    Attributes:
        U, b, log_c: (…, T, D, D), (…, T, D), (…, T): ψ_t(x) = exp(log_c_t − ½|U_t x − b_t|²).
        A, alpha, log_n: likewise, ∫ N(x_t; m, L_t L_tᵀ) ψ_t = exp(log_n_t − ½|A_t m − α_t|²).
        gain, offset, root: (…, T, D, D), (…, T, D), (…, T, D, D):
            x_t given m_t is N(gain_t m_t + offset_t, root_t root_tᵀ).
        F, a, error_root: (…, T−1, …): m_{t+1} given x_t is N(F_t x_t + a_t, R_t R_tᵀ),
            with error_root as R and all rows seen.
        log_evidence: (…) log-integral of the whole chain, without the observations' own normalisers.
    """

    U: np.ndarray
    b: np.ndarray
    log_c: np.ndarray
    A: np.ndarray
    alpha: np.ndarray
    log_n: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    root: np.ndarray
    F: np.ndarray
    a: np.ndarray
    error_root: np.ndarray
    log_evidence: np.ndarray

    def seen_from(self, shift: np.ndarray) -> "BackwardFactors":
        """The same factors in deviations from a path that is off by ``shift`` (…, T, D) from this one's."""
        before, after = shift[..., :-1, :], shift[..., 1:, :]
        return replace(
            self,
            b=self.b - apply(self.U, shift),
            alpha=self.alpha - apply(self.A, shift),
            offset=self.offset + apply(self.gain, shift) - shift,
            a=self.a + apply(self.F, before) - after,
        )


def backward(
    F: np.ndarray,
    a: np.ndarray,
    L: np.ndarray,
    E: np.ndarray,
    e: np.ndarray,
    m0: np.ndarray,
    V: np.ndarray | None = None,
) -> BackwardFactors:
    """Run the recursion from the last row to the first."""
    U, b, log_c = _likelihoods(F, a, L, E, e, V)
    R, B, r, A, alpha = eliminate(U, b, L)
    log_n = log_c - log_abs_det(R)
    evidence = log_n[..., 0] - 0.5 * ((apply(A[..., 0, :, :], m0) - alpha[..., 0, :]) ** 2).sum(-1)
    gain, offset, root = conditional(R, B, r, L)
    error_root = np.zeros((*a.shape, 0))
    if V is not None and V.shape[-1]:
        later = A[..., 1:, :, :]
        S, C, s = _eliminated(later @ V, later @ F, alpha[..., 1:, :] - apply(later, a))[:3]
        error_root = V @ np.linalg.inv(S)
        F, a = F - error_root @ C, a + apply(error_root, s)
    return BackwardFactors(U, b, log_c, A, alpha, log_n, gain, offset, root, F, a, error_root, evidence)


def _likelihoods(
    F: np.ndarray,
    a: np.ndarray,
    L: np.ndarray,
    E: np.ndarray,
    e: np.ndarray,
    V: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U, b and log_c of all rows: the one part that takes rows in turn."""
    batch, (steps, rows, dim) = E.shape[:-3], E.shape[-3:]
    if rows > dim + 1:
        seen = np.asarray(np.linalg.qr(np.concatenate([E, e[..., None]], -1), mode="r"))
        E, e, rows = seen[..., :-1], seen[..., -1], dim + 1
    inner, width = 2 * dim, 2 * dim + 1
    U, b = np.zeros((*batch, steps, dim, dim)), np.zeros((*batch, steps, dim))
    diagonals = np.zeros((*batch, steps, width))
    stacked = np.zeros((*batch, inner + max(rows, 1), width))
    stacked[..., np.arange(dim), np.arange(dim)] = 1.0
    onward = np.empty(0)
    for t in range(steps - 1, -1, -1):
        if t < steps - 1:
            if (place := t % ROWS_AT_ONCE) == ROWS_AT_ONCE - 1 or t == steps - 2:
                block = slice(t - place, t + 1)
                onward = _onward(
                    F[..., block, :, :],
                    a[..., block, :],
                    L[..., 1:, :, :][..., block, :, :],
                    None if V is None else V[..., block, :, :],
                )
            stacked[..., dim:inner, :] = U[..., t + 1, :, :] @ onward[..., place, :, :]
            stacked[..., dim:inner, inner] += b[..., t + 1, :]
        stacked[..., inner : inner + rows, dim:inner] = E[..., t, :, :]
        stacked[..., inner : inner + rows, inner] = e[..., t, :]
        triangle = _reduced(stacked)
        np.multiply(triangle[..., dim:inner, dim:inner], _upper(dim), out=U[..., t, :, :])
        b[..., t, :] = triangle[..., dim:inner, inner]
        diagonals[..., t, :] = triangle.diagonal(0, -2, -1)

    # What each row adds to the constant, summed from the last row on; the last row has no noise after it.
    folded = -0.5 * diagonals[..., inner] ** 2
    folded[..., :-1] -= np.log(np.abs(diagonals[..., :-1, :dim])).sum(-1)
    log_c = np.cumsum(folded[..., ::-1], -1)[..., ::-1].copy()  # torch takes no negative strides
    return U, b, log_c


def _onward(F: np.ndarray, a: np.ndarray, L: np.ndarray, V: np.ndarray | None) -> np.ndarray:
    """N, F and −a (…, T, D, 2D + 1) of some transitions."""
    return np.concatenate([noise_roots(L, V), F, -a[..., None]], -1)


def noise_roots(L: np.ndarray, V: np.ndarray | None) -> np.ndarray:
    """N (…, D, D) with N Nᵀ = L Lᵀ + V Vᵀ."""
    if V is None or not V.shape[-1]:
        return L
    both = np.swapaxes(np.concatenate([L, V], -1), -1, -2)
    return np.swapaxes(np.linalg.qr(both, mode="r"), -1, -2)


def eliminate(U: np.ndarray, b: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, ...]:
    """Integrate ψ(x) = exp(−½|U x − b|²) over x = m + L w: R, B, r, A, α of the decomposition at the top."""
    return _eliminated(U @ L, U, b)


def _eliminated(noise: np.ndarray, state: np.ndarray, constant: np.ndarray) -> tuple[np.ndarray, ...]:
    """Blocks of R of [I 0 | 0; noise state | constant]: the first rows' three, and what remains of the state."""
    batch, (rows, size), dim = constant.shape[:-1], noise.shape[-2:], state.shape[-1]
    count, width = math.prod(batch), size + dim
    R, B, r = np.empty((count, size, size)), np.empty((count, size, dim)), np.empty((count, size))
    A, alpha = np.empty((count, dim, dim)), np.empty((count, dim))
    stacked = np.zeros((min(count, ROWS_AT_ONCE), size + rows, width + 1))
    stacked[:, np.arange(size), np.arange(size)] = 1.0
    noise, state, constant = (each.reshape(count, *each.shape[len(batch) :]) for each in (noise, state, constant))
    for first in range(0, count, ROWS_AT_ONCE):
        here = slice(first, min(first + ROWS_AT_ONCE, count))
        below = stacked[: here.stop - first, size:]
        below[..., :size], below[..., size:width], below[..., width] = noise[here], state[here], constant[here]
        triangle = _reduced(stacked[: here.stop - first])
        np.multiply(triangle[:, :size, :size], _upper(size), out=R[here])
        B[here], r[here] = triangle[:, :size, size:width], triangle[:, :size, width]
        np.multiply(triangle[:, size:width, size:width], _upper(dim), out=A[here])
        alpha[here] = triangle[:, size:width, width]
    return tuple(each.reshape(*batch, *each.shape[1:]) for each in (R, B, r, A, alpha))


@cache
def _upper(size: int) -> np.ndarray:
    return np.triu(np.ones((size, size)))


def _reduced(stacked: np.ndarray) -> np.ndarray:
    """R of the QR decomposition of (…, P, N) matrices, P ≥ N, with leavings under its diagonal."""
    if stacked.ndim > 2:
        return np.swapaxes(np.linalg.qr(stacked, mode="raw")[0], -1, -2)
    # One matrix at a time, what numpy does around LAPACK takes three times as long as LAPACK.
    return dgeqrf(stacked)[0]


def conditional(R: np.ndarray, B: np.ndarray, r: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, ...]:
    """Gain, offset and root of x = m + L w given m, from :func:`eliminate`'s R, B and r."""
    root = L @ np.linalg.inv(R)
    return np.eye(L.shape[-1]) - root @ B, apply(root, r), root


def forward_mean(factors: BackwardFactors, m0: np.ndarray) -> np.ndarray:
    """Posterior mean path (…, T, D)."""
    steps = factors.offset.shape[-2]
    path = np.zeros_like(factors.offset)
    predicted = m0
    for t in range(steps):
        path[..., t, :] = apply(factors.gain[..., t, :, :], predicted) + factors.offset[..., t, :]
        if t < steps - 1:
            predicted = apply(factors.F[..., t, :, :], path[..., t, :]) + factors.a[..., t, :]
    return path


def forward_covariance(factors: BackwardFactors) -> np.ndarray:
    """Posterior marginal covariances (…, T, D, D); sums of squares, so never indefinite."""
    covariance = square(factors.root)
    covariance[..., 1:, :, :] += square(factors.gain[..., 1:, :, :] @ factors.error_root)
    step = factors.gain[..., 1:, :, :] @ factors.F
    for t in range(step.shape[-3]):
        one = step[..., t, :, :]
        covariance[..., t + 1, :, :] += one @ covariance[..., t, :, :] @ np.swapaxes(one, -1, -2)
    return covariance


def square(root: np.ndarray) -> np.ndarray:
    """L Lᵀ (…, D, D) of roots L."""
    return root @ np.swapaxes(root, -1, -2)


def log_abs_det(triangle: np.ndarray) -> np.ndarray:
    """Log |det| of triangular matrices (…, D, D)."""
    return np.log(np.abs(np.diagonal(triangle, axis1=-2, axis2=-1))).sum(-1)


def apply(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Matrices (…, P, D) times vectors (…, D)."""
    return (matrix @ vector[..., None])[..., 0]
