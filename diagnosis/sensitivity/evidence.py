"""Evidence of a candidate from whitened columns: Bayesian linear regression with an unknown noise scale.

With w(φ) = w_0 + A φ, φ ~ N(μ, diag s²), and w ~ N(0, κ² I), where κ is the one unknown factor on all standard
deviations, the evidence given κ is closed (Bishop 2006, §3.5):

    Λ = AᵀA/κ² + diag s⁻²,   φ̂ = Λ⁻¹ (diag s⁻² μ − Aᵀ w_0/κ²)
    log p = −n log κ − ½ log|Λ diag s²| − ½ [ |w_0 + A φ̂|²/κ² + |(φ̂ − μ)/s|² ]  − log_det − ½ n log 2π

κ is taken at its maximum, found by iteration: with n ≫ p its integral adds the same constant for every candidate. A
parameter with bounds has its Gaussian cut there: posterior and prior mass between them are compared.

Only the Gram matrix of the columns enters, so that thousands of candidates cost thousands of p × p solves.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from invdyn.diagnosis.rules import FIXED


@dataclass(frozen=True)
class Regression:
    """Results for H candidates of up to p parameters.

    Attributes:
        log_evidence: (H,).
        mean, covariance: (H, p), (H, p, p) posterior of φ.
        kappa: (H,) factor on the noise.
    """

    log_evidence: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    kappa: np.ndarray


def regression(
    gram: np.ndarray,
    index: np.ndarray,
    offset: np.ndarray,
    prior_mean: np.ndarray,
    prior_sd: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    count: int,
    log_det: np.ndarray | float,
) -> Regression:
    """Evidence of H candidates that share data and columns.

    Args:
        gram: (1 + J, 1 + J) products of the columns, the data first.
        index: (H, p) columns of each candidate's parameters; 0 fills up.
        offset: (H,) column that is added with factor one, or 0 for none.
        prior_mean, prior_sd: (H, p).
        lower, upper: (H, p) bounds, infinite for none.
        count: n.
        log_det: Σ ½ log |S_t|, (H,) or a number.

    A candidate under which the simulation runs away has evidence −∞ and NaN as its mean: products that are not finite,
    or a parameter of typical size that moves the data by more than `diverged_sds` of their standard deviations.
    """
    p = index.shape[1]
    used = index > 0
    i = index
    AA = gram[i[:, :, None], i[:, None, :]] * (used[:, :, None] & used[:, None, :])
    has = (offset > 0).astype(float)
    Ar = (gram[i, 0] + np.where(has[:, None] > 0, gram[i, offset[:, None]], 0.0)) * used
    rr = gram[0, 0] + has * (2 * gram[0, offset] + gram[offset, offset])
    follows = np.isfinite(AA).all((1, 2)) & np.isfinite(Ar).all(1) & np.isfinite(rr)
    moved = np.where(used, np.diagonal(AA, axis1=1, axis2=2) * prior_sd**2, 0.0)
    follows &= (moved < FIXED.diverged_sds**2).all(1)
    AA, Ar = np.where(follows[:, None, None], AA, 0.0), np.where(follows[:, None], Ar, 0.0)
    rr = np.where(follows, rr, 1.0)
    precision = np.where(used, 1 / prior_sd**2, 1.0)
    mu = np.where(used, prior_mean, 0.0)
    kappa2 = np.maximum(rr / count, 1e-12)
    eye = np.eye(p)
    for _ in range(FIXED.kappa_rounds):
        Lambda = AA / kappa2[:, None, None] + precision[:, :, None] * eye
        right = precision * mu - Ar / kappa2[:, None]
        mean = np.linalg.solve(Lambda, right[..., None])[..., 0]
        rest = rr + 2 * (Ar * mean).sum(-1) + np.einsum("hi,hij,hj->h", mean, AA, mean)
        trace = np.einsum("hij,hji->h", AA, np.linalg.inv(Lambda))
        # EM for κ: expected squares under the posterior.
        kappa2 = np.maximum((np.maximum(rest, 0) + trace) / count, 1e-12)
    Lambda = AA / kappa2[:, None, None] + precision[:, :, None] * eye
    covariance = np.linalg.inv(Lambda)
    mean = (covariance @ (precision * mu - Ar / kappa2[:, None])[..., None])[..., 0]
    rest = np.maximum(rr + 2 * (Ar * mean).sum(-1) + np.einsum("hi,hij,hj->h", mean, AA, mean), 0)
    _, log_volume = np.linalg.slogdet(Lambda)
    log_volume = log_volume - np.log(precision).sum(-1)
    quadratic = rest / kappa2 + (precision * (mean - mu) ** 2).sum(-1)
    log_evidence = -0.5 * (count * np.log(2 * np.pi * kappa2) + log_volume + quadratic) - log_det
    sd = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    root = np.sqrt(precision)
    cut = log_mass((lower - mean) / sd, (upper - mean) / sd) - log_mass((lower - mu) * root, (upper - mu) * root)
    log_evidence = np.where(follows, log_evidence + np.where(used, cut, 0.0).sum(-1), -np.inf)
    mean = np.where(follows[:, None], mean, np.nan)
    return Regression(log_evidence, mean, covariance, np.sqrt(kappa2))


def learned(covariance: np.ndarray, prior_sd: np.ndarray) -> np.ndarray:
    """λ (p,) of a posterior: 1 + λ are the eigenvalues of its precision, in units of the prior's."""
    left = np.linalg.eigvalsh(covariance / np.outer(prior_sd, prior_sd))
    return np.maximum(1 / np.maximum(left, np.finfo(float).tiny) - 1, 0.0)


def log_mass(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Log of a unit Gaussian's mass between ``low`` and ``high``, also far out."""
    # Φ differs from 1 in floating point only on its left side.
    mirrored = low > 0
    low, high = np.where(mirrored, -high, low), np.where(mirrored, -low, high)
    upper = log_ndtr(high)
    return upper + np.log1p(-np.exp(np.minimum(log_ndtr(low) - upper, -1e-300)))
