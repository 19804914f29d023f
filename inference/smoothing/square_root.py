"""Square-root information recursions on a linear-Gaussian chain.

Paige & Saunders (1977), "Least squares estimation of discrete linear dynamic systems using
orthogonal transformations"; Bierman (1977), ch. VI. The chain is

    x_0 = m_0 + L_0 w_0,
    m_{t+1} = F_t x_t + a_t + V_t v_t,   x_{t+1} = m_{t+1} + L_{t+1} w_{t+1},   v, w ~ N(0, I),
    rows  E_t x_t ≈ e_t  with unit noise  (whitened observations).

L is the model's own noise; V, optional, is the error of having linearised the prediction m.

Backwards in time, everything that rows t … T−1 say about x_t is one Gaussian factor
ψ_t(x) = exp(c_t − ½|U_t x − b_t|²). One step is two QR decompositions. The first eliminates w:

    [ I        0        | 0 ]        [ R   B | r ]
    [ U L      U        | b ]  =  Q  [ 0   A | α ]      (columns: w, m | right-hand side)

    ∫ N(x'; m, L Lᵀ) ψ(x') dx' = exp(c − ½|A m − α|²) / |det R|
    w given m  ~  N(R⁻¹(r − B m), (RᵀR)⁻¹)

and the second eliminates v and folds in the rows E_t; its residual ρ is added to c:

    [ I      0     | 0       ]        [ S   C | s ]
    [ A V    A F   | α − A a ]  =  Q  [ 0   U | b ]      (columns: v, x | right-hand side)
    [ 0      E     | e       ]        [ 0   0 | ρ ]

Nothing is squared and nothing inverted but R and S, whose singular values are ≥ 1: L may be
singular, observations as sharp as you like, and T as long as you like.

Shapes: numpy float64 with any leading batch (…): F (…, T−1, D, D), a (…, T−1, D), L (…, T, D, D),
V (…, T−1, D, J), E (…, T, O, D), e (…, T, O), m_0 (…, D). Coordinates may be deviations from a path.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg.lapack import dgeqrf


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
    batch, (steps, rows, dim) = E.shape[:-3], E.shape[-3:]
    V = np.zeros((*batch, steps - 1, dim, 0)) if V is None else V
    extra = V.shape[-1]
    U, b = np.zeros((*batch, steps, dim, dim)), np.zeros((*batch, steps, dim))
    A, alpha = np.zeros_like(U), np.zeros_like(b)
    R, B, r = np.zeros_like(U), np.zeros_like(U), np.zeros_like(b)
    S = np.zeros((*batch, steps - 1, extra, extra))
    C, s = np.zeros((*batch, steps - 1, extra, dim)), np.zeros((*batch, steps - 1, extra))
    inner, width = extra + dim, extra + dim + 1
    fold = np.zeros((*batch, inner + max(rows, 1), width))
    rho = np.zeros((*batch, steps))
    for t in range(steps - 1, -1, -1):
        fold[...] = 0.0
        fold[..., np.arange(extra), np.arange(extra)] = 1.0
        if t < steps - 1:
            later = A[..., t + 1, :, :]
            if extra:
                fold[..., extra:inner, :extra] = later @ V[..., t, :, :]
            fold[..., extra:inner, extra:inner] = later @ F[..., t, :, :]
            fold[..., extra:inner, inner] = alpha[..., t + 1, :] - apply(later, a[..., t, :])
        fold[..., inner : inner + rows, extra:inner] = E[..., t, :, :]
        fold[..., inner : inner + rows, inner] = e[..., t, :]
        triangle = _triangle(fold)
        U[..., t, :, :], b[..., t, :] = (
            triangle[..., extra:inner, extra:inner],
            triangle[..., extra:inner, inner],
        )
        rho[..., t] = triangle[..., inner, inner]
        if extra and t < steps - 1:
            S[..., t, :, :], C[..., t, :, :] = (
                triangle[..., :extra, :extra],
                triangle[..., :extra, extra:inner],
            )
            s[..., t, :] = triangle[..., :extra, inner]
        R[..., t, :, :], B[..., t, :, :], r[..., t, :], A[..., t, :, :], alpha[..., t, :] = eliminate(
            U[..., t, :, :], b[..., t, :], L[..., t, :, :]
        )

    # What each row adds to the constants, summed from the last row on.
    folded, integrated = -0.5 * rho**2, -log_abs_det(R)
    if extra:
        folded[..., :-1] -= log_abs_det(S)
    log_n = np.cumsum((folded + integrated)[..., ::-1], -1)[..., ::-1].copy()  # torch takes no negative strides
    log_c = log_n - integrated
    gain, offset, root = conditional(R, B, r, L)
    scattered = np.zeros((*batch, steps - 1, dim, 0))
    if extra:
        scattered = V @ np.linalg.inv(S)
        F, a = F - scattered @ C, a + apply(scattered, s)
    misfit = apply(A[..., 0, :, :], m0) - alpha[..., 0, :]
    log_evidence = log_n[..., 0] - 0.5 * (misfit**2).sum(-1)
    return BackwardFactors(U, b, log_c, A, alpha, log_n, gain, offset, root, F, a, scattered, log_evidence)


def eliminate(U: np.ndarray, b: np.ndarray, L: np.ndarray) -> tuple[np.ndarray, ...]:
    """Integrate ψ(x) = exp(−½|U x − b|²) over x = m + L w: the first decomposition's R, B, r, A, α."""
    dim = b.shape[-1]
    stacked = np.zeros((*b.shape[:-1], 2 * dim, 2 * dim + 1))
    stacked[..., np.arange(dim), np.arange(dim)] = 1.0
    stacked[..., dim:, :dim] = U @ L
    stacked[..., dim:, dim : 2 * dim] = U
    stacked[..., dim:, 2 * dim] = b
    triangle = _triangle(stacked)
    top, bottom = triangle[..., :dim, :], triangle[..., dim:, dim:]
    R, B, r = top[..., :dim], top[..., dim : 2 * dim], top[..., 2 * dim]
    return R, B, r, bottom[..., :dim], bottom[..., dim]


def _triangle(stacked: np.ndarray) -> np.ndarray:
    """R of the QR decomposition of (…, P, N) matrices, (…, min(P, N), N)."""
    if stacked.ndim > 2:
        return np.asarray(np.linalg.qr(stacked, mode="r"))
    # One matrix at a time, what numpy does around LAPACK takes three times as long as LAPACK.
    rows = min(stacked.shape)
    return dgeqrf(stacked)[0][:rows] * _upper(rows, stacked.shape[1])


@cache
def _upper(rows: int, columns: int) -> np.ndarray:
    return np.triu(np.ones((rows, columns)))


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
