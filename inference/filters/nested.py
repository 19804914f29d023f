"""The nested sampler: M independent filters under an outer importance sampler.

Biderman et al. (2020), §3; Naesseth, Lindsten & Schön (2015), "Nested sequential Monte Carlo
methods". Filter m leaves an unbiased evidence Ẑ_m and trajectories; the outer sampler weighs its
trajectories by

    W_m = Ẑ_m / Σ Ẑ,      outer ESS = 1 / Σ W_m²,      Ẑ = (1/M) Σ Ẑ_m   (unbiased).

An outer ESS near M says that every filter found the same posterior; one near 1 that a single
lucky filter carries all of it. Then its error cannot be estimated either: Ẑ_m/mean is M for one and 0 for
all others of any value, whose "standard error" is 1.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from invdyn.inference.filters.resampling import ess


@dataclass(frozen=True)
class OuterWeights:
    """Combination of M filters.

    Attributes:
        log_weights: (M,) normalised log W_m.
        ess: effective number of filters, 1 … M.
        log_evidence: log of the mean of the Ẑ_m.
        log_evidence_sd: its Monte Carlo standard error, sd(Ẑ_m) / (√M mean(Ẑ_m)); NaN of one filter, and where one
            carries more than half of the estimate (``ess`` < 2).
        filter_sd: sd over filters of log Ẑ_m.
    """

    log_weights: Tensor
    ess: float
    log_evidence: float
    log_evidence_sd: float
    filter_sd: float


def outer_weights(log_evidence: Tensor) -> OuterWeights:
    """Combine the filters' log-evidences (M,)."""
    log_evidence = log_evidence.detach().double()
    count = len(log_evidence)
    total = log_evidence.logsumexp(0)
    log_weights = log_evidence - total
    relative = torch.exp(log_weights) * count
    effective = ess(log_evidence).item()
    # Two filters that nearly agree have an ESS just under two, and an error all the same.
    known = count > 1 and (effective >= 2 or effective > 0.75 * count)
    error = relative.std().item() / math.sqrt(count) if known else math.nan
    filter_sd = log_evidence.std().item() if count > 1 else math.nan
    return OuterWeights(log_weights, effective, total.item() - math.log(count), error, filter_sd)
