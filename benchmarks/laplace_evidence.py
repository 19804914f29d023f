"""Parameters by Laplace's evidence, whose derivatives know that the mode moves.

    log p(y | φ) ≈ log p(y, x̂ | φ) + ½ log det(2π P(φ)),    x̂(φ) the most probable path, P the Gaussian's around it

(Tierney and Kadane, JASA 81, 1986). It is maximised with log p(φ) by BFGS in a trust region.
:func:`.marginal_likelihood.fit` shares one linearisation among all parameter sets, and is many times as fast where that
holds. It does not where stiff dynamics meet a wide posterior, as of a body whose lengths are learned from few cameras:
a longer limb is farther away, the path that fits it is another, and a linearisation that stays behind is off by many
deviations of the dynamics. Here each parameter set has its own mode, found by Gauss–Newton from where the last ones say
that it lies, all sets of a difference in one batch.

What is seen under heavy tails counts in P by its share in the least squares that stand in for it.
"""

from collections.abc import Sequence
from typing import Generic

import numpy as np
import torch
from scipy.optimize import BFGS
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, LogParameters, M
from invdyn.inference.fitting.marginal_likelihood import Fit
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models.divergence import Diverged, diverging

STEP, CURVATURE_STEP = 0.03, 0.05
"""Of φ, for slopes and for curvatures: noise and lengths are known to some per cent at best."""
TOLERANCE = 1e-3
"""Nats that a mode's last step gains: differences are of some tenths."""
MAX_LOSS = 100.0
"""Nats less within `CURVATURE_STEP` that no curvature explains."""
FIRST_CURVATURE, RADIUS, MIN_GAIN = 300.0, 0.15, 0.01
"""Curvature that the search begins with, of what is known to 6 %, how far a step may go, and nats that end it."""


def fit_at_mode(
    model: M,
    observations: Tensor,
    free: Sequence[Free],
    *,
    start: Tensor | None = None,
    max_iterations: int = 40,
) -> Fit[M]:
    """Fit the ``free`` parameters, one at least; arguments and result as those of :func:`.marginal_likelihood.fit`.

    Raises KeyError for a parameter that the model does not have, ValueError for none, and Diverged when the model has
    no finite density where the search begins.
    """
    model = model.to(dtype=torch.float64, device="cpu")
    observations = observations.detach().cpu().double()
    model.check_names(f.name for f in free)
    if not free:
        raise ValueError("expected parameters to fit, got none")
    search = _Search(model, observations, free, start)
    phi, value, bends, converged = _descend(search, max_iterations)
    covariance = search.covariance(phi, bends)
    sd = np.sqrt(np.diagonal(covariance))
    return Fit(
        search.parameters.at(torch.as_tensor(phi)),
        -value + 0.5 * ((phi / search.sd) ** 2).sum(),
        search.path,
        {f.name: sd[index] for f, index in zip(search.parameters.free, search.parameters.slices, strict=True)},
        converged,
        phi,
        covariance,
        -value + 0.5 * np.linalg.slogdet(covariance)[1] - np.log(search.sd).sum(),
    )


def _descend(search: "_Search", most: int) -> tuple[np.ndarray, float, np.ndarray, bool]:
    """Where BFGS ends, the value there, its Hessian, and whether a whole step gains no more than `MIN_GAIN`.

    No step is longer than `RADIUS`: beyond, the path is another, and its mode is not found from this one.
    """
    phi, hessian = np.zeros(len(search.sd)), BFGS(init_scale=FIRST_CURVATURE)
    hessian.initialize(len(phi), "hess")
    value, slope = search.value(phi), search.gradient(phi)
    for _ in range(most):
        whole = -np.linalg.solve(hessian.get_matrix(), slope)
        if -0.5 * slope @ whole < MIN_GAIN:
            return phi, value, hessian.get_matrix(), True
        step = whole * min(1.0, RADIUS / np.abs(whole).max())
        while (reached := search.value(phi + step)) > value and np.abs(step).max() > RADIUS / 100:
            step = step / 3
        if reached > value:
            break
        before, phi, value = slope, phi + step, reached
        slope = search.gradient(phi)
        hessian.update(step, slope - before)
    return phi, value, hessian.get_matrix(), False


class _Search(Generic[M]):
    """Negative log-posterior of φ (P,), with a path that was found and how it moves.

    Attributes:
        sd: (P,) of the prior.
        phi, path, slope: where the last gradient was taken, (P,), the most probable path there (T, D), and its slope
            (P, T, D).
    """

    def __init__(self, model: M, observations: Tensor, free: Sequence[Free], start: Tensor | None):
        self.observations, self.parameters = observations, LogParameters(model, free)
        self.sd = self.parameters.sd
        here = self.parameters.at(torch.zeros(len(self.sd), dtype=torch.float64))
        self.path = gauss_newton(here, observations, start=start).path
        self.phi, self.slope = np.zeros(len(self.sd)), torch.zeros(len(self.sd), *self.path.shape, dtype=torch.float64)

    def _at(self, phi: np.ndarray) -> tuple[np.ndarray, Tensor]:
        """Values (B,) at sets (B, P), infinite where the model diverges, and modes (B, T, D)."""
        start = self.path + torch.einsum("bp,ptd->btd", torch.as_tensor(phi - self.phi), self.slope)
        with diverging():
            mode = gauss_newton(
                self.parameters.at(torch.as_tensor(phi)), self.observations, start=start, tolerance=TOLERANCE
            )
        values = 0.5 * ((phi / self.sd) ** 2).sum(-1) - mode.log_evidence.numpy()
        return np.where(np.isfinite(values), values, np.inf), mode.path

    def value(self, phi: np.ndarray) -> float:
        """At φ (P,)."""
        try:
            return float(self._at(phi[None])[0][0])
        except Diverged:
            return np.inf

    def gradient(self, phi: np.ndarray) -> np.ndarray:
        """(P,), by central differences, which also tell where modes of sets nearby will be."""
        size = len(phi)
        values, paths = self._at(phi + STEP * np.concatenate([np.eye(size), -np.eye(size)]))
        self.phi, self.path = phi.copy(), paths.mean(0)
        self.slope = (paths[:size] - paths[size:]) / (2 * STEP)
        return (values[:size] - values[size:]) / (2 * STEP)

    def covariance(self, phi: np.ndarray, bends: np.ndarray) -> np.ndarray:
        """(P, P) by the values' curvature at φ, ``bends`` where no mode is found; nowhere wider than the prior."""
        size = len(phi)
        unit = CURVATURE_STEP * np.eye(size)
        first, second = np.triu_indices(size, 1)
        values, _ = self._at(phi + np.concatenate([np.zeros((1, size)), unit, -unit, unit[first] + unit[second]]))
        middle, up, down, pairs = np.split(values, [1, 1 + size, 1 + 2 * size])
        hessian = np.diag((up + down - 2 * middle) / CURVATURE_STEP**2)
        hessian[first, second] = hessian[second, first] = (pairs - up[first] - up[second] + middle) / CURVATURE_STEP**2
        if not np.isfinite(hessian).all() or (values - values[0]).max() > MAX_LOSS:
            hessian = bends
        values, vectors = np.linalg.eigh(self.sd[:, None] * hessian * self.sd)
        vectors = self.sd[:, None] * vectors
        return vectors / np.maximum(values, 1.0) @ vectors.T
