"""A linear-Gaussian chain as one banded least-squares problem: its mean path and its evidence.

The chain of :mod:`.square_root` is the stack of rows

    L_0⁻¹ (x_0 − m_0) ≈ 0,    N_t⁻¹ (x_{t+1} − F_t x_t − a_t) ≈ 0,    E_t x_t ≈ e_t        or    A x ≈ c,

where N Nᵀ = L Lᵀ + V Vᵀ. AᵀA is block-tridiagonal. LAPACK factorises it in one call for all rows, where a recursion
takes T turns of Python. That its condition number is A's squared is made good by refinement, once or twice,

    x ← x + (AᵀA)⁻¹ Aᵀ (c − A x)

("corrected semi-normal equations": Björck 1996, "Numerical methods for least squares problems", §2.9.4
and §6.6.5). The integral over all paths is that of a Gaussian,

    log ∫ = −Σ log |det N_t| − ½ log |AᵀA| − ½ |A x̂ − c|².

Shapes: as in :mod:`.square_root`, without batch. N must be regular.
"""

from collections.abc import Callable

import numpy as np
import torch
from scipy.linalg.blas import dtbsv
from scipy.linalg.lapack import dpbtrf, dpbtrs

from invdyn.inference.smoothing.square_root import apply, log_abs_det, noise_roots
from invdyn.models.divergence import Singular


def chain_posterior(
    F: np.ndarray,
    a: np.ndarray,
    L: np.ndarray,
    E: np.ndarray,
    e: np.ndarray,
    m0: np.ndarray,
    V: np.ndarray | None = None,
    repair: float = 1e-7,
    tolerance: float = 1e-7,
    noise: np.ndarray | None = None,
) -> tuple[np.ndarray, float, np.ndarray]:
    """Posterior mean path (T, D), log-evidence without the observations' normalisers, and a draw less the mean (T, D).

    The draw is that of standardised ``noise`` (T, D), zero without: it moves smoothly with the chain's numbers.

    Raises Singular where there is no band Cholesky factor: a state without noise, or a condition beyond repair. The
    first refinement is at most ``repair`` of the path, for |AᵀA| is that of the factor and not refined; the last one
    at most ``tolerance``.
    """
    roots = np.concatenate([L[:1], noise_roots(L[1:], V)])
    if not (np.diagonal(roots, axis1=-2, axis2=-1) != 0).all():
        raise Singular("expected noise in every state; the recursions of square_root.py take chains without")
    eye = torch.eye(roots.shape[-1], dtype=torch.float64)
    inverse = torch.linalg.solve_triangular(torch.as_tensor(roots), eye, upper=False).numpy()
    back = inverse[1:] @ F
    within = _gram(inverse) + _gram(E)
    within[:-1] += _gram(back)
    unit = 1 / np.sqrt(np.diagonal(within, axis1=-2, axis2=-1))  # columns of A at length one
    factor, failed = dpbtrf(_band(within, -_transposed(inverse[1:]) @ back, unit), lower=1)
    if failed:
        raise Singular("the chain's normal equations have no Cholesky factor")

    def rows(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A x, the chain's and the observations' part."""
        chain = apply(inverse, x)
        chain[1:] -= apply(back, x[:-1])
        return chain, apply(E, x)

    def solved(chain: np.ndarray, seen: np.ndarray) -> np.ndarray:
        """(AᵀA)⁻¹ Aᵀ times such rows."""
        right = apply(_transposed(inverse), chain) + apply(_transposed(E), seen)
        right[:-1] -= apply(_transposed(back), chain[1:])
        solution, _ = dpbtrs(factor, (unit * right).reshape(-1, 1), lower=1)
        return unit * solution.reshape(unit.shape)

    chain = apply(inverse, np.concatenate([m0[None], a]))
    x, own, seen = _refined(rows, solved, chain, e, unit, repair, tolerance)
    squares = ((chain - own) ** 2).sum() + ((e - seen) ** 2).sum()
    volume = np.log(unit).sum() - np.log(factor[0]).sum() - log_abs_det(roots).sum()
    drawn = np.zeros_like(x)
    if noise is not None:
        drawn = unit * dtbsv(2 * unit.shape[1] - 1, factor, noise.ravel(), lower=1, trans=1).reshape(unit.shape)
    return x, float(volume - 0.5 * squares), drawn


def _refined(
    rows: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    solved: Callable[[np.ndarray, np.ndarray], np.ndarray],
    chain: np.ndarray,
    e: np.ndarray,
    unit: np.ndarray,
    repair: float,
    tolerance: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The path of right-hand sides ``chain`` and ``e``, refined, and its two parts of A x."""
    x = solved(chain, e)
    own, seen = rows(x)
    for most in (repair, tolerance):
        step = solved(chain - own, e - seen)
        x = x + step
        own, seen = rows(x)
        # Columns have length one: a state's standard deviation is at least about that, and less is no error.
        size = np.linalg.norm(step / unit) / (1 + np.linalg.norm(x / unit))
        if not size <= most:
            raise Singular("refinement does not settle")
        if size <= tolerance:
            break
    return x, own, seen


def _band(within: np.ndarray, off_diagonal: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Lower band (2D, T·D) of a scaled block-tridiagonal matrix: its blocks (T, D, D), and those below (T−1, D, D).

    LAPACK's columns are contiguous: column k of a block holds its D − k rows, the D of the block below, and k zeros.
    """
    steps, dim = unit.shape
    columns = np.zeros((steps, dim, 2 * dim))
    for k in range(dim):
        own = unit[:, k, None]
        columns[:, k, : dim - k] = within[:, k:, k] * unit[:, k:] * own
        columns[:-1, k, dim - k : 2 * dim - k] = off_diagonal[:, :, k] * unit[1:] * own[:-1]
    return columns.reshape(steps * dim, 2 * dim).T


def _gram(matrix: np.ndarray) -> np.ndarray:
    return _transposed(matrix) @ matrix


def _transposed(matrix: np.ndarray) -> np.ndarray:
    return np.swapaxes(matrix, -1, -2)
