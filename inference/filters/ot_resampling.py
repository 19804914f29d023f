"""Resampling as transport: equally weighted particles by moving, not by choosing.

Corenflos, Thornton, Deligiannidis & Doucet (2021), "Differentiable particle filtering via entropy-regularized optimal
transport"; Reich (2013) without the entropy; Cuturi (2013) for the iteration. Between the particles weighted by W and
the same particles weighted equally, with C_ij = ½ mean_k ((x_ik − x_jk)/s_k)², s_k the particles' sd in coordinate k,

    P = argmin Σ_ij P_ij C_ij + ε KL(P | W ⊗ 1/N),   Σ_j P_ij = W_i,   Σ_i P_ij = 1/N
    x̃_j = x̄ + N Σ_i P_ij (x_i − x̄),   x̄ = Σ_i W_i x_i

by Sinkhorn's alternating potentials in logarithms. The mean stays what it was, to rounding; the particles' scatter
shrinks with ε and higher moments change, so that a filter's evidence is biased, by O(1/√N) even for ε → 0. Cost: N²
numbers and operations per iteration.

The potentials are found without gradient and a few more updates are differentiated, so that memory does not grow with
the iterations. What the gradient leaves out shrinks as fast as Sinkhorn's iteration converges.
"""

import math

import torch
from torch import Tensor


def transport(x: Tensor, log_weights: Tensor, regularisation: float = 0.5, iterations: int = 50) -> Tensor:
    """Moved particles (M, N, D), of the type of x (M, N, D), for normalised log-weights (M, N), float64.

    Raises ValueError unless ``regularisation``, ε, is positive and ``iterations`` at least 1.
    """
    if not regularisation > 0 or iterations < 1:
        raise ValueError(
            f"expected a regularisation above zero and at least one iteration, got {regularisation}, {iterations}"
        )
    weights = log_weights.exp().unsqueeze(-1)
    mean = (weights * x).sum(-2, keepdim=True)
    deviation = x - mean
    # Not weighted: where one particle has all the weight, that would be nothing.
    variance = x.var(-2, correction=0, keepdim=True)
    sd = torch.where(variance > 0, variance, 1.0).sqrt()
    scaled = deviation / sd
    square = scaled.square().sum(-1)
    # |a − b|² expanded: no tensor (M, N, N, D).
    distance = square.unsqueeze(-1) + square.unsqueeze(-2) - 2 * scaled @ scaled.mT
    cost = distance.clamp_min(0) / (2 * x.shape[-1] * regularisation)
    plan = _plan(cost, log_weights, iterations)
    return (mean + x.shape[-2] * plan.mT @ deviation).to(x.dtype)


def _plan(cost: Tensor, log_weights: Tensor, iterations: int, differentiated: int = 5) -> Tensor:
    """P (M, N, N) for ``cost`` C/ε; its rows i sum to W_i exactly, its columns to 1/N as far as it has converged."""
    uniform = -math.log(cost.shape[-1])

    def pair(f: Tensor, cost: Tensor, log_weights: Tensor) -> tuple[Tensor, Tensor]:
        g = -(f.unsqueeze(-1) + log_weights.unsqueeze(-1) - cost).logsumexp(-2)
        return -(g.unsqueeze(-2) + uniform - cost).logsumexp(-1), g

    with torch.no_grad():
        f = torch.zeros_like(log_weights)
        for _ in range(iterations):
            f, _ = pair(f, cost.detach(), log_weights.detach())
    for _ in range(differentiated):
        f, g = pair(f, cost, log_weights)
    return (f.unsqueeze(-1) + g.unsqueeze(-2) - cost + log_weights.unsqueeze(-1) + uniform).exp()
