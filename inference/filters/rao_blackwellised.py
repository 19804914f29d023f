"""A particle filter that samples the outer state alone, and has a Kalman filter in each particle.

Chen & Liu (2000), "Mixture Kalman filters", JRSS B 62; Doucet, de Freitas, Murphy & Russell (2000), "Rao–Blackwellised
particle filtering for dynamic Bayesian networks". Given its path u_{0:t}, particle i's inner state is N(m_t^i, P_t^i)
by Kalman's recursion, and the weight is that of the outer path, with the inner state integrated out:

    log w_t = log W_{t−1} + log p(u_t | u_{t−1})/q(u_t) + log N(y_t; C m_{t|t−1} + d, C P_{t|t−1} Cᵀ + R).

Ẑ is unbiased, and its variance is no larger than that of a filter of (u, x). With ``proposal="optimal"`` a finite outer
state (:class:`.finite.StateNumber`) is drawn given y_t, after one Kalman step for each of its K values:

    q(u_t = k) ∝ P(u_t = k | u_{t−1}) N(y_t; k),     log w_t = log W_{t−1} + log Σ_k P(u_t = k | u_{t−1}) N(y_t; k).

Smoothing draws lines of outer states from the genealogy, and smooths the inner state given each (Rauch, Tung & Striebel
1965). Far back from the last row the lines meet in a few; more particles, or a higher threshold, part them.

Shapes: M filters, N particles, T rows; u (…, U), x (…, D). All in float64.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.particles import FilterResult, History, take
from invdyn.inference.filters.proposal import draw
from invdyn.inference.filters.resampling import categorical, check_sizes
from invdyn.inference.filters.weights import ancestors_where, normalised
from invdyn.models.conditionally_linear import ConditionallyLinear
from invdyn.models.finite import StateNumber
from invdyn.models.shapes import apply


class Gaussian(NamedTuple):
    """Mean (…, D) and covariance (…, D, D)."""

    mean: Tensor
    covariance: Tensor


@dataclass(frozen=True)
class RaoBlackwellised:
    """Result of :func:`rao_blackwellised`.

    Attributes:
        filter: of the outer state; ``states`` are u (T, M, N, U).
        mean: (T, M, D) E[x_t | y_{0:t+1}].
        covariance: (T, M, D, D) of x_t given y_{0:t+1}.
    """

    filter: FilterResult
    mean: Tensor
    covariance: Tensor


@dataclass(frozen=True)
class InnerSmoothed:
    """Result of :func:`smooth_inner`: R lines a filter, of equal weight.

    Attributes:
        outer: (M, R, T, U) paths of the outer state.
        means, covariances: (M, R, T, D) and (M, R, T, D, D) of x given each path and all observations.
    """

    outer: Tensor
    means: Tensor
    covariances: Tensor

    @property
    def mean(self) -> Tensor:
        """E[x_t | y], (M, T, D)."""
        return self.means.mean(1)


@torch.no_grad()
def rao_blackwellised(
    model: ConditionallyLinear,
    observations: Tensor,
    num_particles: int,
    *,
    seed: int,
    num_filters: int = 1,
    proposal: Literal["prior", "optimal"] = "prior",
    ess_threshold: float = 0.5,
    resampling: str = "systematic",
) -> RaoBlackwellised:
    """Filter ``observations`` (T, O), NaN where missing.

    Args:
        model: conditionally linear-Gaussian.
        observations: (T, O).
        num_particles: N.
        seed: of every random number.
        num_filters: M.
        proposal: "prior", or "optimal" where the outer state is finite.
        ess_threshold: resample a filter when its ESS falls below this share of N; in (0, 1].
        resampling: scheme, as for :class:`ParticleFilter`.

    Raises ModelError for a model that does not fit the observations, ValueError for no particle, another proposal or
    a threshold outside its range, TypeError for "optimal" with an outer state that is not finite, and SMCFailed when
    all particles of a filter have weight zero.
    """
    check_sizes(num_filters, num_particles, ess_threshold)
    if proposal not in ("prior", "optimal"):
        raise ValueError(f'expected the proposal "prior" or "optimal", got {proposal!r}')
    observations = check_model(model, observations).double()
    model = model.to(dtype=torch.float64)
    shape, rows, device = (num_filters, num_particles), len(observations), observations.device
    step = _optimal if proposal == "optimal" else _prior

    uniform = -math.log(num_particles)
    log_weights = torch.full(shape, uniform, dtype=torch.float64, device=device)
    log_evidence = log_weights.new_zeros(num_filters)
    itself = torch.arange(num_particles, device=device).expand(shape)
    history, means, covariances = History(rows, rows, num_filters, device), [], []
    outer, inner, ancestors = None, None, itself
    with seeded(seed, device):
        for t, y in enumerate(observations):
            outer, inner, increment = step(model, shape, outer, inner, y, t)
            log_weights, total, ess = normalised(log_weights, increment)
            if not bool(torch.isfinite(total).all()):
                raise SMCFailed(
                    f"expected a particle of positive weight, got none at row {t}: use more particles or a wider R"
                )
            log_evidence = log_evidence + total
            mixed = _mixed(log_weights.exp(), inner)
            means.append(mixed.mean)
            covariances.append(mixed.covariance)
            history.keep_row(t, outer, log_weights, ancestors, None)

            need = (ess < ess_threshold * num_particles) & (t < rows - 1)
            history.note(t, total, ess, need)
            ancestors = itself
            if bool(need.any()):
                ancestors = ancestors_where(need, log_weights, resampling)
                log_weights = torch.where(need.unsqueeze(-1), uniform, log_weights)
                outer, inner = take(outer, ancestors), Gaussian(*(take(value, ancestors) for value in inner))
    return RaoBlackwellised(history.result(log_evidence), torch.stack(means), torch.stack(covariances))


@torch.no_grad()
def smooth_inner(
    model: ConditionallyLinear, result: RaoBlackwellised, observations: Tensor, num_draws: int, *, seed: int
) -> InnerSmoothed:
    """Smooth x given R lines of outer states for each filter.

    ``observations`` (T, O) are those of ``result``.
    """
    observations = check_model(model, observations).double()
    model = model.to(dtype=torch.float64)
    with seeded(seed, observations.device):
        outer = genealogy(result.filter, num_draws)
    filtered: list[Gaussian] = []
    predicted: list[Gaussian] = []
    for t, y in enumerate(observations):
        predicted.append(_predicted(model, outer[..., t, :], filtered[-1] if t else None, t))
        filtered.append(_updated(model, outer[..., t, :], predicted[-1], y, t)[0])

    smoothed = [filtered[-1]]
    for t in range(len(observations) - 2, -1, -1):
        mean, covariance = filtered[t]
        A, _, _ = model.inner_transition(outer[..., t + 1, :], t + 1)
        ahead, later = predicted[t + 1], smoothed[-1]
        # A pseudo-inverse: a singular Q may leave directions in which nothing is uncertain.
        gain = covariance @ A.mT @ torch.linalg.pinv(ahead.covariance, hermitian=True)
        change = later.covariance - ahead.covariance
        smoothed.append(
            Gaussian(mean + apply(gain, later.mean - ahead.mean), _symmetric(covariance + gain @ change @ gain.mT))
        )
    means, covariances = zip(*smoothed[::-1], strict=True)
    return InnerSmoothed(outer, torch.stack(means, -2), torch.stack(covariances, -3))


Step = tuple[Tensor, Gaussian, Tensor]
"""Outer states (M, N, U), inner Gaussians after y_t, and increments (M, N) of the log-weights."""


def _prior(
    model: ConditionallyLinear, shape: tuple[int, int], outer: Tensor | None, inner: Gaussian | None, y: Tensor, t: int
) -> Step:
    before = model.outer_initial() if outer is None else model.outer_transition(outer, t)
    outer = draw(before.expand(torch.Size(shape)))
    return outer, *_updated(model, outer, _predicted(model, outer, inner, t), y, t)


def _optimal(
    model: ConditionallyLinear, shape: tuple[int, int], outer: Tensor | None, inner: Gaussian | None, y: Tensor, t: int
) -> Step:
    before = model.outer_initial() if outer is None else model.outer_transition(outer, t)
    if not isinstance(before, StateNumber):
        raise TypeError(f'expected a StateNumber as the outer state, got {type(before).__name__}: use proposal="prior"')
    values = before.probabilities.shape[-1]
    every = torch.arange(values, dtype=torch.float64, device=y.device)[:, None].expand(*shape, values, 1)
    spaced = None if inner is None else Gaussian(inner.mean.unsqueeze(-2), inner.covariance.unsqueeze(-3))
    after, log_likelihood = _updated(model, every, _predicted(model, every, spaced, t), y, t)

    joint = before.probabilities.log().expand(*shape, values) + log_likelihood
    index = categorical(joint)
    chosen = index[..., None, None]
    mean = after.mean.gather(-2, chosen.expand(*shape, 1, model.inner_dim)).squeeze(-2)
    covariance = after.covariance.gather(
        -3, chosen[..., None].expand(*shape, 1, model.inner_dim, model.inner_dim)
    ).squeeze(-3)
    return index.unsqueeze(-1).double(), Gaussian(mean, covariance), joint.logsumexp(-1)


def _predicted(model: ConditionallyLinear, outer: Tensor, inner: Gaussian | None, t: int) -> Gaussian:
    """x_t given u_{0:t} and y_{0:t}, of full batch shape."""
    if inner is None:
        mean, covariance = model.inner_initial(outer)
    else:
        A, b, Q = model.inner_transition(outer, t)
        mean, covariance = apply(A, inner.mean) + b, A @ inner.covariance @ A.mT + Q
    batch, size = outer.shape[:-1], mean.shape[-1]
    return Gaussian(mean.expand(*batch, size), covariance.expand(*batch, size, size))


def _updated(model: ConditionallyLinear, outer: Tensor, inner: Gaussian, y: Tensor, t: int) -> tuple[Gaussian, Tensor]:
    """x_t given y_t (O,) too, and log N(y_t; ·) of its entries that were seen, (…)."""
    seen = ~y.isnan()
    if not bool(seen.any()):
        return inner, inner.mean.new_zeros(inner.mean.shape[:-1])
    C, d, R = model.inner_emission(outer, t)
    C, d, R = C[..., seen, :], d[..., seen], R[..., seen, :][..., seen]
    root = torch.linalg.cholesky(C @ inner.covariance @ C.mT + R)
    surprise = y[seen] - apply(C, inner.mean) - d

    # L⁻¹ of the surprise and of C P: all else is squares of them.
    white = torch.linalg.solve_triangular(root, surprise.unsqueeze(-1), upper=False)
    reach = torch.linalg.solve_triangular(root, C @ inner.covariance, upper=False)
    mean = inner.mean + (reach.mT @ white).squeeze(-1)
    covariance = _symmetric(inner.covariance - reach.mT @ reach)
    log_scale = root.diagonal(dim1=-2, dim2=-1).log().sum(-1) + 0.5 * math.log(2 * math.pi) * surprise.shape[-1]
    return Gaussian(mean, covariance), -0.5 * white.square().sum((-2, -1)) - log_scale


def _mixed(weights: Tensor, inner: Gaussian) -> Gaussian:
    """Mean (M, D) and covariance (M, D, D) of the particles' mixture, of weights (M, N)."""
    mean = (weights.unsqueeze(-1) * inner.mean).sum(1)
    off = inner.mean - mean.unsqueeze(1)
    second = inner.covariance + off.unsqueeze(-1) * off.unsqueeze(-2)
    return Gaussian(mean, (weights[..., None, None] * second).sum(1))


def _symmetric(matrix: Tensor) -> Tensor:
    return 0.5 * (matrix + matrix.mT)
