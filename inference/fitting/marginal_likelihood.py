"""Parameters by marginal likelihood: noise scales, λ, σ_τ, σ_y, link lengths, when not given.

Maximises  log p(y | φ) + log p(φ)  over log-parameters φ (:mod:`.log_parameters`, :mod:`.objective`) by Newton's method
in a trust region. Link lengths are known a hundred times better than noise scales: a first-order or quasi-Newton method
crawls here. The posterior of φ is Laplace's.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from invdyn.inference.contract import check_model, in_float64
from invdyn.inference.fitting.log_parameters import Free, M
from invdyn.inference.fitting.objective import Objective
from invdyn.inference.preconditions import LINEARISABLE
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation

PATIENCE = 6
"""Iterations without a gain that end the search; rejected ones shrink the trust region fourfold each."""

MAX_PREDICTED = 0.1
"""Nats that a last step may gain unseen. Where it should gain more, its end is evaluated, and taken if it is better."""


@dataclass
class Fit(Generic[M]):
    """Result of :func:`fit`.

    Attributes:
        model: with the fitted parameters.
        log_evidence: of the linearised model at the optimum.
        path: (T, D) mode, a warm start for what follows.
        log_sd: per parameter, posterior sd of the log of its entries (Laplace), or of entries over their unit.
        converged: whether the optimiser met its tolerance.
        phi: (P,) the optimum, in the coordinates of :class:`LogParameters`.
        covariance: (P, P) posterior covariance of φ (Laplace).
        log_marginal: log p(y) with φ integrated out over its prior (Laplace), nats: what models are compared by.
        scatter: (D,) squared error, as a share, that a state's variance has if one φ is drawn
            (:meth:`Objective.scatter`); empty where it is not known.
    """

    model: M
    log_evidence: float
    path: Tensor
    log_sd: dict[str, np.ndarray]
    converged: bool
    phi: np.ndarray
    covariance: np.ndarray
    log_marginal: float
    scatter: np.ndarray = field(default_factory=lambda: np.zeros(0))


def fit(
    model: M,
    observations: Tensor,
    free: Sequence[Free],
    *,
    start: Tensor | None = None,
    max_iterations: int = 40,
    progress: Callable[[int, int], None] | None = None,
    begin: Mapping[str, Tensor] | None = None,
) -> Fit[M]:
    """Fit the ``free`` parameters; all but those with a unit must be positive.

    Args:
        model: at its starting parameters, which are also the prior's centre.
        observations: (T, O), NaN where missing.
        free: what to fit.
        start: path (T, D) to linearise at first.
        max_iterations: of the optimiser.
        progress: called with (iterations done, max_iterations).
        begin: parameters by name at which to begin the search, where better ones than the prior's centre are known.

    Raises KeyError for a parameter that the model does not have, and Diverged where the start has no finite evidence.
    """
    model, observations = in_float64(model, observations)
    model.check_names(f.name for f in free)
    if not free:
        smoother = posterior_linearisation(model, observations, gauss_newton(model, observations, start=start))
        none, evidence = np.zeros(0), smoother.log_evidence.item()
        return Fit(
            model, evidence, smoother.path, {}, True, none, np.zeros((0, 0)), evidence, np.zeros(model.state_dim)
        )
    objective = Objective(model, observations, free, start)
    # Once: copies with other numbers inherit the result.
    check_model(model, observations, needs=LINEARISABLE)

    def report(done: int, phi: np.ndarray) -> bool:
        if progress is not None:
            progress(min(done, max_iterations), max_iterations)
        return objective.last_step(phi) is not None

    widening = max(1.0, (len(objective.sd) / 10) ** 0.5)  # many parameters share a step
    phi, converged = minimum(
        objective, objective.parameters.of(begin or {}), max_iterations, widening=widening, report=report
    )
    value, hessian = objective.value(phi), objective.curvature(phi)
    path = torch.as_tensor(objective.path)
    if (last := objective.last_step(phi)) is not None:
        step, gain = last
        if gain < MAX_PREDICTED:
            phi, value, path = phi + step, value - gain, path + objective.moved(step)
        elif (there := objective.value(phi + step)) < value:
            phi, value, path = phi + step, there, torch.as_tensor(objective.path)
    log_evidence = -value + 0.5 * ((phi / objective.sd) ** 2).sum()
    covariance = laplace(objective, hessian)
    sd = np.sqrt(np.diagonal(covariance))
    return Fit(
        objective.at(phi),
        log_evidence,
        path,
        {f.name: sd[index] for f, index in zip(objective.free, objective.slices, strict=True)},
        converged,
        phi,
        covariance,
        -value + 0.5 * np.linalg.slogdet(covariance)[1] - np.log(objective.sd).sum(),
        objective.scatter(covariance),
    )


def minimum(
    objective: Any,
    begin: np.ndarray,
    max_iterations: int,
    *,
    widening: float = 1.0,
    sets: int = 1,
    report: Callable[[int, np.ndarray], bool] | None = None,
) -> tuple[np.ndarray, bool]:
    """φ (P,) of an objective's least value, by Newton's method from ``begin``, and whether the search converged.

    The objective, of ``sets`` data sets, has value, gradient and hessian. ``widening`` is that of the trust region.
    ``report`` is called with (iterations done, φ), and says whether the search may end there.
    """
    reached: list[float] = []

    def after(intermediate_result: Any) -> None:
        reached.append(intermediate_result.fun)
        if report is not None and report(len(reached), intermediate_result.x):
            raise StopIteration
        if len(reached) > PATIENCE and reached[-1 - PATIENCE] - reached[-1] < 0.02:
            raise StopIteration  # nothing that the data could tell, down to a tiny trust region

    found = minimize(
        objective.value,
        begin,
        jac=objective.gradient,
        hess=objective.hessian,
        method="trust-exact",
        callback=after,
        options={
            "maxiter": max_iterations,
            "initial_trust_radius": 0.5 * widening,
            "max_trust_radius": 1.5 * widening,
            # Curvatures add up, so that a slope of √N leaves the same share of a standard deviation as 1 of one set.
            "gtol": 0.3 * sets**0.5,
        },
    )
    return found.x, bool(found.success) or len(reached) < max_iterations


def laplace(objective: Objective, hessian: np.ndarray) -> np.ndarray:
    """Covariance of φ from the Hessian at the optimum; in no direction wider than the prior.

    In units of the prior's sd the prior alone has curvature 1. Where the evidence is not convex that stands in.
    """
    sd = objective.sd
    values, vectors = np.linalg.eigh(sd[:, None] * hessian * sd)
    vectors = sd[:, None] * vectors
    return vectors / np.maximum(values, 1.0) @ vectors.T
