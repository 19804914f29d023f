"""Scales of noise by marginal likelihood, of a model whose means they do not move and are dear to evaluate.

With the means fitted over a posterior N(x̄, P) once (:mod:`.posterior_linearisation`), the evidence of the linear model

    x_{t+1} ≈ f̄_t + F_t (x_t − x̄_t) + L(φ) w + V_t v,     y_t ≈ h̄_t + H_t (x_t − x̄_t) + R(φ)^½ u

is known for any scales φ in L and R without another step of the simulation. So in turn

    φ ← argmax log p_lin(y | φ; N(x̄, P)) + log p(φ),      N(x̄, P) ← smoother at φ,

as in a Laplace–EM of Fahrmeir & Wagenpfeil (1997), "Penalized likelihood estimation and iterative Kalman smoothing for
non-Gaussian dynamic regression models". Here φ is the logarithm of a scale over its last turn's
value, and p(φ) a wide Gaussian about 0: it damps each turn, and what the turns settle at is of maximum likelihood.

Shapes: φ (P,), observations (T, O).
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, LogParameters, M
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, mean_and_evidence
from invdyn.inference.smoothing.posterior_linearisation import Fitted
from invdyn.inference.smoothing.statistical_homotopy import statistical_homotopy
from invdyn.models.divergence import Diverged, diverging

ROUNDS, SETTLED = 6, 0.05
"""Turns at most, and by how much φ, a logarithm, may still change."""
MAX_STEP = 1.0
"""Of a logarithm in one turn: N(x̄, P) belongs to the scales before."""


def fit_scales(
    model: M,
    observations: Tensor,
    free: Sequence[Free],
    smoother: GaussianSmoother,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[M, GaussianSmoother, bool]:
    """Return the model with fitted scales, its smoother, and whether the fit settled.

    Args:
        model: in which ``free`` parameters are scales of noise, of the transition or the emission, and move no mean.
        observations: (T, O), NaN where missing.
        free: what to fit.
        smoother: of the model as it is.
        progress: called with (turns done, turns at most).
    """
    settled = not free
    for turn in range(ROUNDS if free else 0):
        parameters = LogParameters(model, free)
        fitted = Fitted.of(model, observations, smoother.path, smoother.covariance())
        phi = _best(parameters, fitted)
        model = parameters.at(torch.as_tensor(phi))
        smoother = statistical_homotopy(model, observations, smoother)
        if progress is not None:
            progress(turn + 1, ROUNDS)
        if settled := bool(np.abs(phi).max() < SETTLED):
            break
    return model, smoother, settled


def _best(parameters: LogParameters, fitted: Fitted) -> np.ndarray:
    """φ (P,) of the highest evidence, given what was fitted."""

    def value(phi: np.ndarray) -> float:
        try:
            with diverging():
                _, evidence, _ = mean_and_evidence(fitted.linear(parameters.at(torch.as_tensor(phi))))
        except Diverged:
            return 1e10
        prior = 0.5 * float(((phi / parameters.sd) ** 2).sum())
        return float(np.nan_to_num(prior - evidence, nan=1e10, posinf=1e10))

    size = len(parameters.sd)
    found = minimize(
        value,
        np.zeros(size),
        method="L-BFGS-B",
        bounds=[(-MAX_STEP, MAX_STEP)] * size,
        options={"maxiter": 20, "ftol": 1e-7, "eps": 1e-3},
    )
    return np.asarray(found.x)
