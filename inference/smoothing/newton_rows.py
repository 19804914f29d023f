"""Any emission as rows of unit noise on the state: a Newton step on log g(y | x) itself.

Fahrmeir (1992), "Posterior mode estimation by extended Kalman filtering for multivariate dynamic generalized linear
models"; Durbin & Koopman (2012), "Time series analysis by state space methods", §10.6. With the gradient g and the
negative Hessian Λ of ℓ_t(x) = log g(y_t | x) at the path x̄_t,

    ℓ_t(x̄ + d) ≈ ℓ_t(x̄) + gᵀd − ½ dᵀΛd = c − ½ |E d − e|²,     EᵀE = Λ,   Eᵀe = g,   c = ℓ_t(x̄) + ½ |e|².

Rows of the state, not of the mean: what y says through the emission's scale (stochastic volatility), through a rate
(Poisson), a probability (Bernoulli) or an angle (von Mises) counts as what it says through a Gaussian's mean. In the
eigenvectors of Λ

    E = diag(√λ) Vᵀ,   e = diag(1/√λ) Vᵀg,   λ ← max(λ, (vᵀg / REACH)²),

so that the quadratic is concave everywhere: a direction in which log g is convex, as far from a mode of a bimodal
emission, keeps its slope, and of curvature only what bounds the step.

Over a Gaussian N(x̄_t, P_t) instead of at a point, ℓ, g and Λ are averages over 2D cubature points; Λ is then the one
of the closest Gaussian in the Kullback–Leibler sense (Opper & Archambeau 2009).

Gaussian and Student-t emissions whose noise does not depend on the state, and rows that bring a Gaussian fit of their
own, keep Gauss–Newton's exact whitened rows (:func:`.missing.gaussian_rows`): :func:`keeps_noise` tells them apart.

Shapes: path (…, T, D), observations (T, O), E (…, T, D, D), e (…, T, D), c (…, T).
"""

import torch
from pyro.distributions import Distribution, Independent
from torch import Tensor

from invdyn.models.observation.missing import RowDistribution, observed_log_prob
from invdyn.models.state_space import StateSpaceModel, gaussian_moments

REACH = 1e3
"""Length of a Newton step in standard deviations of its own quadratic, at most."""


def keeps_noise(model: StateSpaceModel, path: Tensor, emission: Distribution) -> bool:
    """Whether ``emission`` is Gaussian or Student-t about a mean, with noise that does not depend on the state.

    Or a model says that its noise is to be taken as it is (:attr:`.StateSpaceModel.emission_about_mean`).

    Compared at ``path`` (…, T, D), where ``emission`` is the model's, and a prior's standard deviation to either side.
    """
    if model.emission_about_mean or isinstance(emission, RowDistribution):
        return True
    noise, rows = _noise(emission), torch.arange(path.shape[-2])
    if noise is None:
        return False
    with torch.no_grad():
        # A scale that was broadcast over the rows cannot depend on their states.
        if all(value.stride(-1 - rank) == 0 for value, rank in noise):
            return True
        for other in nudged(model, path):
            there = _noise(model.emission(other, rows))
            if there is None or any(not torch.equal(a, b) for (a, _), (b, _) in zip(noise, there, strict=True)):
                return False
    return True


def _noise(emission: Distribution) -> list[tuple[Tensor, int]] | None:
    """Noise parameters of a family that :func:`.missing.gaussian_rows` fits, and their rank in a row; else None."""
    if isinstance(emission, torch.distributions.MultivariateNormal):
        return [(emission.scale_tril, 2)]
    base = emission.base_dist if isinstance(emission, Independent) else emission
    if isinstance(base, torch.distributions.Normal):
        return [(base.scale, 1)]
    if isinstance(base, torch.distributions.StudentT):
        return [(base.scale, 1), (base.df, 1)]
    return None


def nudged(model: StateSpaceModel, path: Tensor) -> tuple[Tensor, Tensor]:
    """``path`` (…, T, D), a standard deviation of the first row's prior to either side, less in each state."""
    sd = gaussian_moments(model.initial())[1].reshape(-1, path.shape[-1], path.shape[-1])[0].norm(dim=-1)
    step = torch.where(sd > 0, sd, 1.0) / (1 + 0.1 * torch.arange(path.shape[-1]))
    return path + step, path - step


def newton_rows(model: StateSpaceModel, path: Tensor, observations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """E, e and c along ``path``; see the top of the file. Rows of which nothing was seen are zero."""
    value, gradient, precision = _derivatives(model, path, observations)
    return _rows(value, gradient, precision)


def averaged_newton_rows(
    model: StateSpaceModel, path: Tensor, root: Tensor, observations: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """E, e and c over N(path, root rootᵀ), root (…, T, D, D), in deviations from path."""
    columns = root.mT.movedim(-2, 0) * path.shape[-1] ** 0.5
    points = torch.cat([path + columns, path - columns])
    value, gradient, precision = (each.mean(0) for each in _derivatives(model, points, observations))
    # The quadratic has the mean of log g, which at x̄ itself is higher.
    value = value + 0.5 * (precision * (root @ root.mT)).sum((-2, -1))
    return _rows(value, gradient, precision)


def _rows(value: Tensor, gradient: Tensor, precision: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    curvature, vectors = torch.linalg.eigh(precision)
    slope = (vectors.mT @ gradient.unsqueeze(-1)).squeeze(-1)
    root = torch.maximum(curvature, (slope / REACH).square()).sqrt()
    e = torch.where(root > 0, slope / root, 0.0)
    return root.unsqueeze(-1) * vectors.mT, e, value + 0.5 * e.square().sum(-1)


def _derivatives(model: StateSpaceModel, path: Tensor, observations: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Log g (…, T), its gradient (…, T, D) and negative Hessian (…, T, D, D), by D + 1 backward passes for all rows."""
    dim = path.shape[-1]
    value = path.new_zeros(path.shape[:-1])
    gradient, precision = torch.zeros_like(path), path.new_zeros(*path.shape, dim)
    seen = (~torch.isnan(observations)).any(-1).nonzero().squeeze(-1)
    if len(seen) == 0:
        return value, gradient, precision

    with torch.enable_grad():
        x = path[..., seen, :].detach().clone().requires_grad_()
        log_density = observed_log_prob(model.emission(x, seen), observations[seen])
        # Each row's log g depends on its own state alone, so the gradient of the sum holds that of every row.
        slope = _gradient(log_density.sum(), x)
        bend = torch.stack([_gradient(slope[..., d].sum(), x) for d in range(dim)], -2)

    value[..., seen] = log_density.detach()
    gradient[..., seen, :] = slope.detach()
    precision[..., seen, :, :] = -0.5 * (bend + bend.mT).detach()
    return value, gradient, precision


def _gradient(total: Tensor, x: Tensor) -> Tensor:
    """Gradient, zero of what does not depend on x."""
    if not total.requires_grad:
        return torch.zeros_like(x)
    found = torch.autograd.grad(total, x, create_graph=True, allow_unused=True)[0]
    return torch.zeros_like(x) if found is None else found
