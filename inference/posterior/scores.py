"""Scores of a weighted sample against what was true: error, CRPS, coverage.

Gneiting & Raftery (2007), "Strictly proper scoring rules". For draws x_i of weight w_i, Σ w_i = 1, and truth y,

    RMSE      root mean square over time of Σ w_i x_i − y
    CRPS      Σ_i w_i |x_i − y| − Σ_ij w_i w_j |x_i − x_j| / (2 (1 − Σ w_i²))
    coverage  share of times at which y lies between the (1 ± p)/2 quantiles

The CRPS, in the unit of y, is the absolute error of a point and rewards a distribution that is neither too wide nor too
narrow. The factor 1 − Σ w_i² makes it fair (Ferro 2014): without it few independent draws score worse than many of
the same distribution. Sorted, the double sum is Σ_k x_k w_k (C_{k−1} + C_k − 1) with C_k = w_1 + … + w_k.

Shapes: draws (S, …), weights (S,), truth (…); all but S is scored entry by entry.
"""

import numpy as np


def crps(draws: np.ndarray, weights: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Continuous ranked probability score (…), the smaller the better; NaN where ``truth`` is."""
    deviation, weights = _sorted(draws - truth, weights)
    error = (weights * np.abs(deviation)).sum(0)
    total = weights.cumsum(0)
    scatter = (deviation * weights * (2 * total - weights - 1)).sum(0)
    distinct = 1 - (weights**2).sum(0)
    one = 1e-12  # under which all weight is on one draw, which has no scatter
    return error - np.where(distinct > one, scatter / np.maximum(distinct, one), 0.0)


def quantile(draws: np.ndarray, weights: np.ndarray, levels: tuple[float, ...]) -> np.ndarray:
    """Weighted quantiles (L, …): the k-th sorted draw stands at C_k − w_k/2, straight lines between."""
    ordered, weights = _sorted(draws, weights)
    place = weights.cumsum(0) - weights / 2
    shape = ordered.shape[1:]
    columns = zip(place.reshape(len(place), -1).T, ordered.reshape(len(place), -1).T, strict=True)
    return np.stack([np.interp(levels, at, values) for at, values in columns], axis=-1).reshape(len(levels), *shape)


def coverage(draws: np.ndarray, weights: np.ndarray, truth: np.ndarray, level: float) -> np.ndarray:
    """Share of the leading axis of ``truth`` (T, …) whose central interval of probability ``level`` holds it; NaN
    entries of the truth do not count.
    """
    low, high = quantile(draws, weights, ((1 - level) / 2, (1 + level) / 2))
    return _mean(np.where(np.isnan(truth), np.nan, (low <= truth) & (truth <= high)))


def rmse(draws: np.ndarray, weights: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Root mean square error of the weighted mean over the leading axis of ``truth`` (T, …)."""
    mean = np.tensordot(weights / weights.sum(), draws, 1)
    return np.sqrt(_mean((mean - truth) ** 2))


def score_table(draws: np.ndarray, weights: np.ndarray, truth: np.ndarray) -> dict[str, np.ndarray]:
    """All of them, over time: draws (S, T, K), truth (T, K), each score (K,); NaN where nothing is known."""
    return {
        "rmse": rmse(draws, weights, truth),
        "crps": _mean(crps(draws, weights, truth)),
        "coverage_50": coverage(draws, weights, truth, 0.5),
        "coverage_90": coverage(draws, weights, truth, 0.9),
    }


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over the leading axis of what is not NaN; NaN of nothing."""
    known = np.isfinite(values)
    return np.divide(
        np.where(known, values, 0.0).sum(0), known.sum(0), where=known.any(0), out=np.full(values.shape[1:], np.nan)
    )


def _sorted(draws: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Draws in order along the first axis, and the normalised weight of each, of the same shape."""
    order = np.argsort(draws, axis=0, kind="stable")
    return np.take_along_axis(draws, order, 0), (weights / weights.sum())[order]
