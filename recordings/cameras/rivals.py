"""Where else a point may be: with three cameras and a stray pixel, two of three pairs may each agree on a place.

A stray is anywhere in what its camera shows, of area A. So a pixel's density at a distance d from the projection is

    (1 − ε) (1 + w d²/(ν σ²))^−(ν+2)/2 · w/(2π σ²)  +  ε/A,

with ε, the share of strays, by EM (one stray and one good pixel are counted beforehand: Laplace's rule). A point may be
elsewhere if it were not N times less likely there, with one stray and all other pixels at their peak. Then each pair of
cameras leads to a mode x_k with a covariance C_k. Modes weigh π_k ∝ p(y | x_k) |C_k|^½ (Laplace); of those nearer than
one standard deviation one counts. About the mode x that is reported the covariance is

    Σ_k π_k [ C_k + (x_k − x)(x_k − x)ᵀ ].

Shapes: N points, C cameras, M modes.
"""

import numpy as np

ROUNDS = 50
"""Of EM, which settles long before: one number is learned of thousands of pixels."""


def stray_share(good: np.ndarray, area: np.ndarray) -> float:
    """ε, of log densities of good pixels (N, C), NaN where there is none, and log areas (C,)."""
    share = 0.5
    seen = np.isfinite(good)
    for _ in range(ROUNDS):
        share = (stray(good, area, share)[seen].sum() + 1) / (seen.sum() + 2)
    return float(share)


def stray(good: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Probability of each pixel (..., C) that it is a stray."""
    odds = np.clip(good + area + np.log1p(-share) - np.log(share), -700, 700)
    return np.nan_to_num(1 / (1 + np.exp(odds)))


def may_be_elsewhere(good: np.ndarray, peak: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Which points (N,) a mode with one stray may compete for; ``peak`` (N, C): log densities of the best pixels."""
    least = np.nanmin(peak + area, axis=1)  # the pixel that it costs least to give up
    elsewhere = np.nansum(peak, axis=1) - least + np.log(share)
    return elsewhere - log_density(good, area, share) > -np.log(len(good))


def log_density(good: np.ndarray, area: np.ndarray, share: float) -> np.ndarray:
    """Of all pixels of a point, good ones or strays, (...)."""
    seen = np.isfinite(good)
    each = np.logaddexp(np.where(seen, good, 0.0) + np.log1p(-share), np.log(share) - area)
    return np.where(seen, each, 0.0).sum(axis=-1)


def spread(points: np.ndarray, covariance: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The weightiest modes (N,), and the covariance (N, 3, 3) about them.

    Of modes (M, N, 3) with covariances (M, N, 3, 3), NaN where a mode is none, and log densities (M, N).
    """
    told = np.isfinite(covariance).all((-1, -2))
    sign, volume = np.linalg.slogdet(np.where(told[..., None, None], covariance, np.eye(3)))
    weight = np.where(told & (sign > 0), density + 0.5 * volume, -np.inf)
    order = np.argsort(-weight, axis=0, kind="stable")
    each = np.arange(points.shape[1])
    kept = np.full(weight.shape, -np.inf)
    for place, now in enumerate(order):
        alone = np.ones(len(each), dtype=bool)
        for before in order[:place]:
            off = (points[now, each] - points[before, each])[..., None]
            inverse = np.linalg.pinv(np.nan_to_num(covariance[before, each]))
            far = (off.swapaxes(-1, -2) @ inverse @ off)[:, 0, 0] >= 1
            alone &= far | ~np.isfinite(kept[before, each])
        kept[now, each] = np.where(alone, weight[now, each], -np.inf)
    best = order[0]
    share = np.exp(kept - np.where(np.isfinite(kept[best, each]), kept[best, each], 0.0))
    share = share / np.maximum(share.sum(0), 1e-300)
    off = points - points[best, each]
    about = np.nan_to_num(covariance) + off[..., :, None] * off[..., None, :]
    return best, (share[..., None, None] * about).sum(0)
