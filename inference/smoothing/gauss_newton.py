"""The path of highest posterior density, and the Gaussian around it.

Gauss–Newton (iterated extended Kalman) smoother with Levenberg–Marquardt damping: Bell (1994),
"The iterated Kalman smoother as a Gauss–Newton method"; Särkkä & Svensson (2020),
"Levenberg–Marquardt and line-search extended Kalman smoothers". At the current path x̄ the
transition and the emission are linearised (:mod:`.linearisation`),

    x_{t+1} ≈ f(x̄_t) + F_t (x_t − x̄_t) + L w,     W_t (y_t − h(x̄_t) − H_t (x_t − x̄_t)) ~ N(0, I),

and the linear problem is solved exactly, by one band Cholesky factor a chain (:mod:`.banded`) where the mean is all
that is needed, by the recursions of :mod:`.square_root` where factors are. A step d that does not raise log p(x, y)
is corrected to second order: nearly deterministic dynamics are hurt by their own bend, which a touch of torque would
mend (the Maratos effect; Nocedal & Wright, "Numerical Optimization", 2006, sections 15.6 and 18.3). The linear problem
is solved once more with what the transition is truly off there, less the slopes' share,

    f(x̄_t + d_t) − x̄_{t+1} − d_{t+1} − (F_t d_t − d_{t+1})     in place of     f(x̄_t) − x̄_{t+1}.

If that does not help, either, the step is repeated with damping rows √μ (x_t − x̄_t)/s.

With the last linearisation come the Laplace-type evidence (exact for linear-Gaussian models) and the
factors ψ_t that the controlled guide twists by.

Shapes: observations (T, O), path (…, T, D); the leading dimensions are many parameter sets of
one model, each with its own path and damping. All in float64.
"""

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.contract import in_float64
from invdyn.inference.preconditions import LINEARISABLE
from invdyn.inference.smoothing.banded import chain_posterior
from invdyn.inference.smoothing.linearisation import (
    Deviations,
    Linearisation,
    Slopes,
    deviations,
    linearise,
    log_joint,
)
from invdyn.inference.smoothing.square_root import (
    BackwardFactors,
    apply,
    backward,
    forward_covariance,
    forward_mean,
)
from invdyn.models.divergence import Diverged, Singular, check_finite
from invdyn.models.fixed_point import settled
from invdyn.models.state_space import StateSpaceModel, gaussian_moments


@dataclass
class GaussianSmoother:
    """Result of :func:`gauss_newton`.

    Attributes:
        path: (…, T, D) the mode.
        factors: ψ_t and friends, relative to ``path``.
        linearisation: at ``path``.
        log_evidence: (…) log of the linearised model's evidence.
        log_joint: (…) log p(path, y).
        converged: (…) bool.
    """

    path: Tensor
    factors: BackwardFactors
    linearisation: Linearisation
    log_evidence: Tensor
    log_joint: Tensor
    converged: Tensor

    def covariance(self) -> Tensor:
        """Marginal posterior covariances (…, T, D, D)."""
        return torch.as_tensor(forward_covariance(self.factors))

    def of_set(self, k: int) -> "GaussianSmoother":
        """That of set k among many."""

        def pick(value: Any) -> Any:
            if is_dataclass(value):
                kind: Any = type(value)
                return kind(**{field.name: pick(getattr(value, field.name)) for field in fields(value)})
            return None if value is None else value[k]

        return pick(self)


def solve(linear: Linearisation) -> BackwardFactors:
    """Backward factors of a linearised model."""
    return backward(linear.F, linear.a, linear.L, linear.E, linear.e, linear.m0, linear.V)


def mean_and_evidence(linear: Linearisation, **options: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What :func:`.chain_posterior` has of a linearised model's chains (…), in a fraction of :func:`solve`'s time.

    Mean paths (…, T, D), log-evidence (…) and draws less the means (…, T, D): NaN where the chain is :func:`solve`'s,
    which squares nothing. With a ``repair`` over its default the evidence is not to be relied on.
    """
    pieces = [getattr(linear, name) for name in ("F", "a", "L", "E", "e", "m0")]
    pieces += [] if linear.V is None else [linear.V]
    batch = linear.m0.shape[:-1]
    try:
        found = [chain_posterior(*(piece[chain] for piece in pieces), **options) for chain in np.ndindex(batch)]
    except Singular:
        factors = solve(linear)
        mean = forward_mean(factors, linear.m0)
        return mean, factors.log_evidence + linear.log_constant, np.full_like(mean, np.nan)
    mean, evidence, drawn = (np.stack(each) for each in zip(*found, strict=True))
    shape = (*batch, *mean.shape[1:])
    return mean.reshape(shape), evidence.reshape(batch) + linear.log_constant, drawn.reshape(shape)


def _damped(linear: Linearisation, damping: np.ndarray, scale: np.ndarray) -> Linearisation:
    """The same with rows √μ d/s more, of ``damping`` μ (…) and ``scale`` s (D,)."""
    if not np.any(damping > 0):
        return linear
    dim = linear.E.shape[-1]
    rows = np.sqrt(damping)[..., None, None, None] * np.diag(1 / scale)
    E = np.concatenate([linear.E, np.broadcast_to(rows, (*linear.E.shape[:-2], dim, dim))], -2)
    e = np.concatenate([linear.e, np.zeros((*linear.e.shape[:-1], dim))], -1)
    return replace(linear, E=E, e=e)


def gauss_newton(
    model: StateSpaceModel,
    observations: Tensor,
    *,
    start: Tensor | None = None,
    max_iterations: int = 50,
    tolerance: float = 1e-3,
    slopes: Slopes | None = None,
) -> GaussianSmoother:
    """Find the mode of p(x_{0:T} | y) and the Gaussian around it.

    Without a ``start`` it is found by a homotopy: all of the model's candidate paths are improved
    under relaxed dynamics, the best one is kept, and the dynamics are tightened step by step.
    Stiff dynamics (ε ≪ 1) would otherwise make every Gauss–Newton step a bad one.

    Args:
        model: with Gaussian transition noise; parameters (…, 1, own shape) for batches.
        observations: (T, O), NaN where missing.
        start: path (…, T, D) to begin at.
        max_iterations: linearisations at most, at the last stage.
        tolerance: stop when a step gains less than this, in nats.
        slopes: to take everywhere instead of the model's own: many parameter sets that are nearly the same may share
            those of one of them, as slopes are most of a step's work. What is found is nearly the mode.

    Raises ModelError for a model that does not fit the observations, a transition or an emission that has no Gaussian
    approximation here, and an emission whose mean says nothing of the state; Diverged when the starting path has no
    finite density.
    """
    model, observations = in_float64(model, observations, needs=LINEARISABLE)
    if start is None:
        start = _by_homotopy(model, observations)
    start = start.detach().cpu().double()
    path, merit, done, linear = _ascend(model, observations, start, max_iterations, tolerance, slopes)
    linear = linear or linearise(model, path, observations, slopes=slopes)
    factors = solve(linear)
    evidence = torch.as_tensor(factors.log_evidence + linear.log_constant)
    return GaussianSmoother(path, factors, linear, evidence, merit, done)


def gauss_newton_path(
    model: StateSpaceModel, observations: Tensor, start: Tensor, max_iterations: int, tolerance: float
) -> Tensor:
    """The path alone, (…, T, D), that :func:`gauss_newton` would find from ``start``; raises as it does."""
    model, observations = in_float64(model, observations)
    return _ascend(model, observations, start.detach().cpu().double(), max_iterations, tolerance)[0]


def _by_homotopy(model: StateSpaceModel, observations: Tensor) -> Tensor:
    path = model.initial_paths(observations)
    for amount in (1.0, 0.3, 0.1, 0.03, 0.01, 0.003):
        relaxed = model.relaxed(amount)
        if relaxed is model:
            return path[0]
        # Candidates part ways in how often they wind round, and outliers mislead some: two are clearly best at once.
        for count, steps in ((2, 1), (1, 3)) if path.ndim == 3 else ():
            path, merit, *_ = _ascend(relaxed, observations, path, max_iterations=steps, tolerance=1.0)
            path = path[merit.nan_to_num(-torch.inf).argsort(descending=True, stable=True)[:count]]
        path = path[0] if path.ndim == 3 else _ascend(relaxed, observations, path, max_iterations=4, tolerance=1.0)[0]
    return path


def _ascend(
    model: StateSpaceModel,
    observations: Tensor,
    path: Tensor,
    max_iterations: int,
    tolerance: float,
    slopes: Slopes | None = None,
) -> tuple[Tensor, Tensor, Tensor, Linearisation | None]:
    """Damped Gauss–Newton steps from ``path``; returns path, log-joint, converged, and the linearisation if it has it.

    Slopes are computed only where a step begins: those that are refused, and the last one, need none.
    """
    batch = path.shape[:-2]
    scale = gaussian_moments(model.initial())[1]
    scale = scale.reshape(-1, *scale.shape[-2:])[0].norm(dim=-1).numpy()
    path = settled(model, path)
    here, linear = deviations(model, path, observations), None
    merit = log_joint(here)
    if not np.isfinite(merit).any():
        check_finite(path)
        check_finite(torch.as_tensor(np.concatenate([here.m0[..., None, :], here.a], -2)))
        raise Diverged("the starting path has no finite density: check noise scales and units")
    damping, done = np.zeros(batch), np.zeros(batch, dtype=bool)
    for _ in range(max_iterations):
        linear = linear or linearise(model, path, observations, here, slopes)
        step, candidate, there, reached = _tried(model, observations, path, linear, damping, scale)
        if (refused := (reached - merit < -tolerance) & ~done).any():
            _, other, beyond, more = _tried(model, observations, path, bent(linear, step, there), damping, scale)
            if (mended := refused & (more > reached)).any():
                candidate = torch.where(torch.as_tensor(mended)[..., None, None], other, candidate)
                reached = np.where(mended, more, reached)
                there = beyond if mended.all() else deviations(model, candidate, observations)
        gain = reached - merit
        better = (gain >= 0) & ~done
        if better.any():
            path = torch.where(torch.as_tensor(better)[..., None, None], candidate, path)
            here, linear = there if better.all() else deviations(model, path, observations), None
        merit = np.where(better, reached, merit)
        near = (damping == 0) & (gain > -tolerance)  # a whole step, and hardly a difference
        damping = np.where(better, damping / 10, np.maximum(damping, 1e-5) * 10)
        damping = np.where(damping < 1e-4, 0.0, damping)
        # A step that gains nothing, or none that can, ends the search.
        done = done | (better & (gain < tolerance)) | (~better & near) | (np.abs(gain) < 1e-9) | (damping > 1e12)
        if done.all():
            break
    return path, torch.as_tensor(merit), torch.as_tensor(done), linear


def _tried(
    model: StateSpaceModel,
    observations: Tensor,
    path: Tensor,
    linear: Linearisation,
    damping: np.ndarray,
    scale: np.ndarray,
) -> tuple[np.ndarray, Tensor, Deviations, np.ndarray]:
    """The step from ``path`` of ``linear``, the path after it, what is off there, and log p(x, y) (…)."""
    with np.errstate(over="ignore", invalid="ignore"):
        step, *_ = mean_and_evidence(_damped(linear, damping, scale), repair=np.inf)
    # A step that is not finite is refused, and the model is not evaluated there: it may check its values and raise.
    finite = np.isfinite(step).all((-2, -1))
    step = np.where(finite[..., None, None], step, 0.0)
    candidate = settled(model, path + torch.as_tensor(step))
    there = deviations(model, candidate, observations)
    reached = np.nan_to_num(log_joint(there), nan=-np.inf, neginf=-np.inf)
    return step, candidate, there, np.where(finite, reached, -np.inf)


def bent(linear: Linearisation, step: np.ndarray, there: Deviations) -> Linearisation:
    """``linear`` with the transitions' deviations as they are after a ``step`` (…, T, D), less its slopes' share."""
    a = there.a - (apply(linear.F, step[..., :-1, :]) - step[..., 1:, :])
    return replace(linear, a=np.where(np.isfinite(a).all((-2, -1), keepdims=True), a, linear.a))
