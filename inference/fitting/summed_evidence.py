"""Parameters that several data sets share, by the sum of their evidences (empirical Bayes).

    φ̂ = argmax Σ_i log p(y_i | φ) + log p(φ),     φ = log(θ / θ_0)

(Carlin & Louis 2000, *Bayes and Empirical Bayes Methods for Data Analysis*, ch. 3). Each data set has a model of its
own, whose path and initial state nothing else shares. All models stand at the same θ_0, the prior's centre, so that φ
means the same in each. Evidence, gradient and Hessian of each are those of :mod:`.objective`; the prior that
every one of them has is counted once.

Shapes: N data sets, P parameters φ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, M
from invdyn.inference.fitting.marginal_likelihood import laplace, minimum
from invdyn.inference.fitting.objective import Objective
from invdyn.models.divergence import Diverged

MAX_ITERATIONS = 12  # of the search: each is a fit of every recording


@dataclass
class SharedFit(Generic[M]):
    """Result of :func:`fit_summed`.

    Attributes:
        models: (N) with the shared parameters.
        paths: (N) modes (T, D).
        phi: (P,) the optimum.
        covariance: (P, P) of φ (Laplace).
        log_evidence: (N,) of each data set at the optimum.
        converged: whether the optimiser met its tolerance.
    """

    models: list[M]
    paths: list[Tensor]
    phi: np.ndarray
    covariance: np.ndarray
    log_evidence: np.ndarray
    converged: bool


def at_common_start(models: Sequence[M], free: Sequence[Free]) -> list[M]:
    """The models with free parameters at their mean over models: geometric where positive, else arithmetic."""
    values = {}
    for f in free:
        stacked = torch.stack([model.parameters[f.name] for model in models])
        mean, positive = stacked.mean(0), (stacked > 0).all(0) & (f.unit is None)
        values[f.name] = torch.where(positive, stacked.clamp(min=1e-300).log().mean(0).exp(), mean)
    return [model.replace(**values) for model in models]


def fit_summed(
    models: Sequence[M],
    observations: Sequence[Tensor],
    free: Sequence[Free],
    *,
    starts: Sequence[Tensor | None],
    phi: np.ndarray | None = None,
) -> SharedFit[M]:
    """Fit the ``free`` parameters that all models share.

    Args:
        models: N, at one common start (:func:`at_common_start`).
        observations: (T_i, O) of each, NaN where missing.
        free: what is shared, at least one.
        starts: path (T_i, D) of each to linearise at first.
        phi: (P,) where the search begins; 0 by default.

    Raises ValueError for models whose free parameters differ, and Diverged where one has no finite evidence at the
    start.
    """
    models = [model.to(dtype=torch.float64, device="cpu") for model in models]
    for f in free:
        if not all(torch.equal(model.parameters[f.name], models[0].parameters[f.name]) for model in models):
            raise ValueError(f"expected models at one common start, got others of {f.name}: call at_common_start")
    parts = [
        Objective(model, rows.detach().cpu().double(), free, start)
        for model, rows, start in zip(models, observations, starts, strict=True)
    ]
    summed = _Summed(parts)
    begin = np.zeros(len(summed.sd)) if phi is None else np.asarray(phi, float)
    phi, converged = minimum(summed, begin, MAX_ITERATIONS, sets=len(parts))
    values = np.array([part.value(phi) for part in parts])
    if (values >= 1e9).any():
        raise Diverged("a data set has no finite evidence at the shared parameters")
    prior = 0.5 * ((phi / summed.sd) ** 2).sum()
    curvature = sum(part.curvature(phi) for part in parts) - (len(parts) - 1) * np.diag(summed.sd**-2)
    return SharedFit(
        [part.at(phi) for part in parts],
        [torch.as_tensor(part.path) for part in parts],
        phi,
        laplace(parts[0], curvature),
        prior - values,
        converged,
    )


class _Summed:
    """Sum of negative log-posteriors, their common prior counted once."""

    def __init__(self, parts: Sequence[Objective]):
        self.parts, self.sd = parts, parts[0].sd
        self._more = (len(parts) - 1) / self.sd**2

    def value(self, phi: np.ndarray) -> float:
        return sum(part.value(phi) for part in self.parts) - 0.5 * float((self._more * phi**2).sum())

    def gradient(self, phi: np.ndarray) -> np.ndarray:
        return np.sum([part.gradient(phi) for part in self.parts], axis=0) - self._more * phi

    def hessian(self, phi: np.ndarray) -> np.ndarray:
        return np.sum([part.hessian(phi) for part in self.parts], axis=0) - np.diag(self._more)
