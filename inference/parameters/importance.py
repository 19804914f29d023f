"""Evidence from draws of the posterior, by importance sampling with an estimated likelihood.

Tran, Scharth, Gunawan, Kohn, Brown & Hawkins (2021), "Robustly estimating the marginal likelihood for cognitive models
via importance sampling" (IS²):

    Ẑ = (1/K) Σ_k p(z_k) p̂(y | z_k) / q(z_k),     z_k ~ q = (1 − ε) t_ν(μ, Σ) + ε p,

with μ, Σ the draws' moments. It is unbiased where p̂ is. The share ε of the prior bounds the weights by p̂/ε, however
poorly the Student-t fits (Hesterberg 1995, "Weighted average importance sampling and defensive mixture distributions").
"""

import math
from collections.abc import Callable

import torch
from pyro.distributions import MultivariateStudentT
from torch import Tensor

from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.parameters.random_walk import RIDGE, weighted_moments
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters


@torch.no_grad()
def importance_evidence(
    space: UnconstrainedParameters,
    z: Tensor,
    log_likelihood: Callable[[Tensor], Tensor],
    num_draws: int,
    *,
    prior_share: float = 0.1,
    df: float = 5.0,
) -> tuple[float, float]:
    """Log-evidence and its standard error, nats, from draws z (K', P) of the posterior; by torch's global generator.

    Args:
        space: the parameters and their prior.
        z: draws of the posterior, or near it.
        log_likelihood: (K,) at (K, P), or the logarithm of unbiased estimates.
        num_draws: K.
        prior_share, df: ε and ν.
    """
    mean, covariance = weighted_moments(z, z.new_zeros(len(z)))
    root = torch.linalg.cholesky(covariance + RIDGE * torch.eye(space.size, dtype=z.dtype))
    student = MultivariateStudentT(z.new_tensor(df), mean, root)

    from_prior = max(1, round(prior_share * num_draws))
    proposed = torch.cat([space.draw((from_prior,)), student.sample((num_draws - from_prior,))])
    share = from_prior / num_draws
    log_prior = space.log_prior(proposed)
    log_proposal = torch.logaddexp(math.log(share) + log_prior, math.log1p(-share) + student.log_prob(proposed))
    outer = outer_weights(log_prior + log_likelihood(proposed) - log_proposal)
    return outer.log_evidence, outer.log_evidence_sd
