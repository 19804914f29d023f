"""Resampling: N ancestors a ~ W, for many filters at once, with no loop over them.

Chopin & Papaspiliopoulos, "An Introduction to Sequential Monte Carlo" (2020), ch. 9. Each scheme
is unbiased, E[#{n : a_n = i}] = N W_i; they differ in the variance of these counts.

    multinomial   independent draws
    stratified    one uniform in each of N strata of the cumulative sum
    systematic    one uniform, shifted through the N strata (default)
    residual      ⌊N W_i⌋ copies for certain, the rest by systematic draws of the remainder

Shapes: log-weights (M, N), of each filter, not necessarily normalised → ancestors (M, N), int64,
sorted. Cumulative sums are in float64 for any type of the weights, and ancestors are clamped to
N − 1, so that rounding never makes an index that does not exist.
"""

from collections.abc import Callable

import torch
from torch import Tensor


def _inverse_cdf(weights: Tensor, points: Tensor) -> Tensor:
    """First index whose cumulative weight exceeds each of the sorted ``points`` (M, N) in [0, 1)."""
    cumulative = weights.cumsum(-1)
    points = points * cumulative[..., -1:]
    index = torch.searchsorted(cumulative, points.contiguous(), right=True)
    # Trailing particles of weight zero must not be reached through rounding either.
    last = (weights > 0).to(torch.int64).cumsum(-1).argmax(-1, keepdim=True)
    return torch.minimum(index, last)


def _uniform(weights: Tensor, columns: int) -> Tensor:
    return torch.rand(*weights.shape[:-1], columns, dtype=torch.float64, device=weights.device)


def multinomial(weights: Tensor) -> Tensor:
    """Independent draws: the baseline."""
    return _inverse_cdf(weights, _uniform(weights, weights.shape[-1]).sort(-1).values)


def stratified(weights: Tensor) -> Tensor:
    """One draw a stratum."""
    size = weights.shape[-1]
    strata = torch.arange(size, dtype=torch.float64, device=weights.device)
    return _inverse_cdf(weights, (strata + _uniform(weights, size)) / size)


def systematic(weights: Tensor) -> Tensor:
    """One draw in all, shifted.

    The points (j + u)/N are evenly spaced, so a cumulative weight C lies above ⌈N C − u⌉ of them. Point j's ancestor is
    the number of particles that lie above no more than j points. That is a histogram and its running sum: N additions,
    where a search would take N log N steps through memory.
    """
    size = weights.shape[-1]
    cumulative = weights.cumsum(-1)
    total = cumulative[..., -1:]
    below = (cumulative * (size / total) - _uniform(weights, 1)).ceil()
    # Trailing particles of weight zero lie above all of them under any rounding; so does the last one before
    # them, and no ancestor can come to N.
    below = torch.where(cumulative < total, below.clamp(max=size), size).long()
    counts = torch.zeros(*weights.shape[:-1], size + 1, dtype=torch.int64, device=weights.device)
    counts.scatter_add_(-1, below, torch.ones_like(below))
    return counts[..., :-1].cumsum(-1)


def residual(weights: Tensor) -> Tensor:
    """Whole copies first; the R that are left over by systematic draws of the remainders."""
    size = weights.shape[-1]
    expected = size * weights / weights.sum(-1, keepdim=True)
    # A count such as 2.9999999999 is 3 with rounding.
    whole = torch.floor(expected + 1e-9)
    rest = (expected - whole).clamp_min(0)
    missing = size - whole.sum(-1, keepdim=True)
    # Cumulative counts of whole copies; slots beyond them are filled from the remainders.
    slots = torch.arange(size, dtype=torch.float64, device=weights.device).expand_as(weights)
    certain = torch.searchsorted(whole.cumsum(-1), slots.contiguous(), right=True)
    points = (slots - whole.sum(-1, keepdim=True) + _uniform(weights, 1)) / missing.clamp_min(1)
    drawn = _inverse_cdf(rest, points.clamp(0, 1 - 1e-12))
    index = torch.where(slots < size - missing, certain.clamp(max=size - 1), drawn)
    return index.sort(-1).values


RESAMPLERS: dict[str, Callable[[Tensor], Tensor]] = {
    "systematic": systematic,
    "stratified": stratified,
    "residual": residual,
    "multinomial": multinomial,
}


def resample(log_weights: Tensor, scheme: str = "systematic") -> Tensor:
    """Ancestors (M, N) drawn from log-weights (M, N); see the table at the top.

    Raises ValueError for an unknown scheme.
    """
    if scheme not in RESAMPLERS:
        raise ValueError(f"expected a resampling scheme among {', '.join(RESAMPLERS)}, got {scheme!r}")
    log_weights = log_weights.double()
    weights = torch.softmax(log_weights, -1)
    return RESAMPLERS[scheme](weights)


def check_sizes(num_filters: int, num_particles: int, ess_threshold: float) -> None:
    """Raise ValueError unless there is a filter and a particle, and the threshold, a share of N, is in (0, 1]."""
    if num_particles < 1 or num_filters < 1 or not 0 < ess_threshold <= 1:
        raise ValueError(
            f"expected at least one particle and filter and an ess_threshold in (0, 1], got {num_particles}, "
            f"{num_filters} and {ess_threshold}"
        )


def ess(log_weights: Tensor) -> Tensor:
    """Effective sample size (Σ W)² / Σ W² over the last dimension; computed in float64."""
    log_weights = log_weights.double()
    return torch.exp(2 * log_weights.logsumexp(-1) - (2 * log_weights).logsumexp(-1))


def categorical(logits: Tensor) -> Tensor:
    """One index for each leading entry from unnormalised log-probabilities (…, N); NaN counts as zero."""
    logits = logits.double().nan_to_num(nan=-torch.inf, neginf=-torch.inf)
    # Gumbel-max: no normalisation, and one pass however peaked the weights are.
    uniform = torch.rand_like(logits).clamp_min(torch.finfo(logits.dtype).tiny)
    return (logits - torch.log(-torch.log(uniform))).argmax(-1)
