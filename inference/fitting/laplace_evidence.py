"""Parameters by Laplace's evidence, whose derivatives know that the mode moves.

    log p(y | φ) ≈ log p(y, x̂ | φ) + ½ log det(2π P(φ)),    x̂(φ) the likeliest path, P the Gaussian's around it

(Tierney and Kadane, JASA 81, 1986). It is maximised with log p(φ) by BFGS. :func:`.marginal_likelihood.fit` shares one
linearisation among all parameter sets, and is many times as fast where that holds. It does not where stiff dynamics
meet a wide posterior, as of a body whose lengths are learned from few cameras: a longer limb is farther away, the
path that fits it is another, and a linearisation that stays behind is off by many deviations of the dynamics. Here
each parameter set has its own mode, found by Gauss–Newton from the last one, all sets of a difference in one batch.

What is seen under heavy tails counts in P by its share in the least squares that stand in for it.
"""

from collections.abc import Sequence

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from invdyn.inference.fitting.marginal_likelihood import Fit, Free, LogParameters, M
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models.divergence import Diverged, diverging

STEP, APART = 0.03, 0.1
"""Of φ, for slopes and for curvatures: noise and lengths are told to some per cent at best."""
TOLERANCE = 1e-3
"""Nats that a mode's last step gains: differences are of some tenths."""
FIRST = 1e-3
"""Of a gradient, the first step."""


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
    result = minimize(
        search.value,
        np.zeros(len(search.sd)),
        jac=search.gradient,
        method="BFGS",
        options={"hess_inv0": FIRST * np.eye(len(search.sd)), "gtol": 0.3, "maxiter": max_iterations},
    )
    slope = search.gradient(result.x)
    value, covariance = search.value(result.x), search.covariance(result.x)
    sd = np.sqrt(np.diagonal(covariance))
    return Fit(
        search.parameters.at(torch.as_tensor(result.x)),
        -value + 0.5 * ((result.x / search.sd) ** 2).sum(),
        search.path,
        {f.name: sd[index] for f, index in zip(search.parameters.free, search.parameters.slices, strict=True)},
        bool(np.abs(slope * sd).max() < 0.3),
        result.x,
        covariance,
        -value + 0.5 * np.linalg.slogdet(covariance)[1] - np.log(search.sd).sum(),
    )


class _Search:
    """Negative log-posterior of φ (P,), with a path that was found and how it moves.

    Attributes:
        sd: (P,) of the prior.
        phi, path, slope: where the last gradient was taken, (P,), the likeliest path there (T, D), and its (P, T, D).
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

    def covariance(self, phi: np.ndarray) -> np.ndarray:
        """(P, P) by the values' curvature at φ; in no direction wider than the prior."""
        size = len(phi)
        unit = APART * np.eye(size)
        first, second = np.triu_indices(size, 1)
        values, _ = self._at(phi + np.concatenate([np.zeros((1, size)), unit, -unit, unit[first] + unit[second]]))
        middle, up, down, pairs = np.split(values, [1, 1 + size, 1 + 2 * size])
        hessian = np.diag((up + down - 2 * middle) / APART**2)
        hessian[first, second] = hessian[second, first] = (pairs - up[first] - up[second] + middle) / APART**2
        bends, vectors = np.linalg.eigh(self.sd[:, None] * hessian * self.sd)
        vectors = self.sd[:, None] * vectors
        return vectors / np.maximum(bends, 1.0) @ vectors.T
