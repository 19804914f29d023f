"""Points with several possible positions: with three cameras and one outlier, two of three pairs may each agree on one.

An outlier lies anywhere in its camera's picture, of area A. So a pixel's density at a distance d from the projection is

    (1 − ε) (1 + w d²/(ν σ²))^−(ν+2)/2 · w/(2π σ²)  +  ε/A,

with ε, the share of outliers, by EM (one outlier and one good pixel are counted beforehand: Laplace's rule). A point is
ambiguous if another position, with one outlier and all other pixels at their peak, would not be N times less likely.
Then each pair of cameras gives a mode x_k with a covariance C_k. Modes have weights π_k ∝ p(y | x_k) |C_k|^½
(Laplace); of those within one standard deviation of each other one counts. About the reported mode x the covariance is

    Σ_k π_k [ C_k + (x_k − x)(x_k − x)ᵀ ].

Shapes: N points, C cameras, M modes.
"""

import numpy as np

EM_ROUNDS = 50
"""More than enough: one number is learned from thousands of pixels."""


def outlier_share(good: np.ndarray, area: np.ndarray) -> float:
    """ε, of log densities of good pixels (N, C), NaN where there is none, and log areas (C,)."""
    share = 0.5
    seen = np.isfinite(good)
    for _ in range(EM_ROUNDS):
        share = (outlier_probability(good, area, share)[seen].sum() + 1) / (seen.sum() + 2)
    return float(share)


def outlier_probability(good: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Of each pixel (..., C)."""
    odds = np.clip(good + area + np.log1p(-share) - np.log(share), -700, 700)
    return np.nan_to_num(1 / (1 + np.exp(odds)))


def ambiguous(good: np.ndarray, peak: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Which points (N,) may have another mode, with one outlier; ``peak`` (N, C): log densities at zero distance."""
    lowest = np.nanmin(peak + area, axis=1)  # of the pixel that is taken for the outlier
    elsewhere = np.nansum(peak, axis=1) - lowest + np.log(share)
    return elsewhere - log_density(good, area, share) > -np.log(len(good))


def log_density(good: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Of all pixels of a point, good ones or outliers, (...)."""
    seen = np.isfinite(good)
    each = np.logaddexp(np.where(seen, good, 0.0) + np.log1p(-share), np.log(share) - area)
    return np.where(seen, each, 0.0).sum(axis=-1)


def combine_modes(points: np.ndarray, covariance: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The modes (N,) of largest weight, and the covariance (N, 3, 3) about them.

    Of modes (M, N, 3) with covariances (M, N, 3, 3), NaN where there is no mode, and log densities (M, N).
    """
    known = np.isfinite(covariance).all((-1, -2))
    sign, volume = np.linalg.slogdet(np.where(known[..., None, None], covariance, np.eye(3)))
    weight = np.where(known & (sign > 0), density + 0.5 * volume, -np.inf)
    order = np.argsort(-weight, axis=0, kind="stable")
    each = np.arange(points.shape[1])
    kept = np.full(weight.shape, -np.inf)
    for place, now in enumerate(order):
        separate = np.ones(len(each), dtype=bool)
        for before in order[:place]:
            off = (points[now, each] - points[before, each])[..., None]
            inverse = np.linalg.pinv(np.nan_to_num(covariance[before, each]))
            far = (off.swapaxes(-1, -2) @ inverse @ off)[:, 0, 0] >= 1
            separate &= far | ~np.isfinite(kept[before, each])
        kept[now, each] = np.where(separate, weight[now, each], -np.inf)
    best = order[0]
    share = np.exp(kept - np.where(np.isfinite(kept[best, each]), kept[best, each], 0.0))
    share = share / np.maximum(share.sum(0), 1e-300)
    off = points - points[best, each]
    about = np.nan_to_num(covariance) + off[..., :, None] * off[..., None, :]
    return best, (share[..., None, None] * about).sum(0)
