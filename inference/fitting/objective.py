"""Negative log-posterior of log-parameters φ, with gradient and Hessian.

    −log p(y | φ) − log p(φ),   p(y | φ) of the posterior-linearised model (:mod:`.posterior_linearisation`)

On planar arms that evidence lies within about a nat of the SMC evidence. Gradient and Hessian come by finite
differences in one batch: all perturbed parameter sets share the posterior N(x̄, P) that the model is linearised over,
and run through one backward recursion together. Means that a parameter does not move are fitted once.

Under heavy tails the least squares that stand in for rows have the right gradient, but a Hessian whose sign may be
wrong: it serves the search. What is reported of parameters comes from differences of gradients, each at its own mode.

Shapes: P log-parameters, B sets of them, T rows, D states.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, LogParameters, M
from invdyn.inference.smoothing.gauss_newton import gauss_newton, mean_and_evidence
from invdyn.inference.smoothing.posterior_linearisation import (
    SharedMeans,
    fit_linear,
    moved_means,
    posterior_linearisation,
)
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.observation.missing import is_gaussian

STEP = 2e-3
"""Finite-difference step of a log-parameter: lengths are known to a part in a thousand, and the evidence is smooth."""

REPAIR = 1e-9
"""Of :func:`.chain_posterior`: second differences divide what rounding leaves of an evidence by ``STEP`` squared."""

GRADIENT_STEP, MAX_GRADIENT_STEP = 0.25, 0.1
"""How far the gradient is looked at from an optimum: in standard deviations of a parameter, and of its logarithm."""

LEFT, HEAVY_MIN_GAIN = 0.05, 5e-3
"""The search ends where one Newton step is left. From d posterior sds away such a step of a
logarithm of sd s ends some d² s from the optimum: its gain of ½ d² nats is at most ``LEFT`` / s, for a tenth of an sd.
Under heavy tails no step is left, and at most so many nats."""

FRESH = 3
"""Evaluations before a whole Hessian of many parameters: of fifteen one costs as much as four others."""

SETS_AT_ONCE, ROWS_AT_ONCE = 32, 20_000
"""Parameter sets that are computed at once, and their rows: more are hardly quicker, and take memory."""

NOT_FINITE = (
    "the fit cannot start: expected a finite evidence with finite slopes, got none; look for places far from all "
    "others, such as a missing point written as 0, and check units and the body's lengths"
)


@dataclass(frozen=True)
class _Expansion:
    """What was found at φ.

    Attributes:
        phi: its bytes.
        value: and gradient (P,), Hessian (P, P).
        path: (T, D) mode.
        over: mean and covariance that the model was linearised over.
        alone: log-evidences at φ, and with one parameter up (P,), and the Hessian's diagonal (P,).
        moves: how mean path and a draw's way from it move with φ (2, P, T, D), and the states' variances (T, D).
        age: how many evaluations ago all entries of the Hessian were computed, and not its diagonal alone.
    """

    phi: bytes
    value: float
    gradient: np.ndarray
    hessian: np.ndarray
    path: Tensor
    over: tuple[Tensor, Tensor]
    alone: tuple[np.ndarray, np.ndarray, np.ndarray]
    moves: tuple[np.ndarray, np.ndarray]
    age: int


class Objective(Generic[M]):
    """Negative log-posterior of φ with gradient and Hessian, and a warm-started path."""

    def __init__(self, model: M, observations: Tensor, free: Sequence[Free], start: Tensor | None):
        self.observations, self.parameters = observations, LogParameters(model, free)
        self.free, self.slices, self.sd = self.parameters.free, self.parameters.slices, self.parameters.sd
        self.path = start
        self.heavy = not is_gaussian(model.emission(observations.new_zeros(1, model.state_dim), torch.arange(1)))
        self._known: _Expansion | None = None  # of the last evaluation that was finite
        self._noise = np.random.default_rng(0).standard_normal((len(observations), model.state_dim))

    def at(self, phi: np.ndarray) -> M:
        """See :meth:`LogParameters.at`."""
        return self.parameters.at(torch.as_tensor(phi))

    def value(self, phi: np.ndarray) -> float:
        """Negative log-posterior."""
        return self._evaluate(phi)[0]

    def gradient(self, phi: np.ndarray) -> np.ndarray:
        """(P,)."""
        return self._evaluate(phi)[1]

    def hessian(self, phi: np.ndarray) -> np.ndarray:
        """(P, P): its diagonal, and correlations of at most ``FRESH`` evaluations before."""
        return self._evaluate(phi)[2]

    def last_step(self, phi: np.ndarray) -> tuple[np.ndarray, float] | None:
        """The whole Newton step (P,) from φ and the nats it should gain, where it is the last one; else None."""
        known = self._known
        if known is None or known.phi != phi.tobytes():
            return None
        gradient = known.gradient
        values, vectors = np.linalg.eigh(known.hessian)
        if values[0] <= 0:
            return None
        step = -vectors @ ((gradient @ vectors) / values)
        gain = -0.5 * float(gradient @ step)
        if gain >= (HEAVY_MIN_GAIN if self.heavy else LEFT * np.sqrt(values[0])):
            return None
        return (np.zeros_like(step), 0.0) if self.heavy else (step, gain)

    def curvature(self, phi: np.ndarray) -> np.ndarray:
        """Hessian (P, P) where the search ended: by differences of the gradient if what is seen has heavy tails."""
        _, gradient, hessian = self._evaluate(phi)
        known = self._known
        if known is None or known.phi != phi.tobytes():
            return hessian  # there is no evidence here
        if not self.heavy:
            if known.age:
                with diverging():
                    pairs, _ = self._shifted(phi, _pairs(len(phi)), *known.over, 0)
                hessian = _whole_hessian(known.alone, pairs)
                self._known = replace(known, hessian=hessian, age=0)
            return hessian
        steps = GRADIENT_STEP / np.sqrt(np.maximum(np.abs(np.diagonal(hessian)), 1 / self.sd**2))
        rows = np.zeros_like(hessian)
        try:
            for k, step in enumerate(np.clip(steps, STEP, MAX_GRADIENT_STEP)):
                with diverging():
                    rows[k] = (self._expand(phi + step * np.eye(len(phi))[k]).gradient - gradient) / step
        except Diverged:
            rows = hessian
        return (rows + rows.T) / 2

    def _evaluate(self, phi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        found = self._known
        if found is None or found.phi != phi.tobytes():
            try:
                with diverging():
                    found = self._expand(phi)
                if not all(np.isfinite(each).all() for each in (found.value, found.gradient, found.hessian)):
                    raise Diverged(NOT_FINITE)
            except Diverged:
                if self._known is None:
                    raise
                # Out of the linearisation's reach: the trust region shrinks.
                return 1e10, np.zeros_like(phi), np.eye(len(phi))
            self._known, self.path = found, found.path
        return found.value, found.gradient, found.hessian

    def _expand(self, phi: np.ndarray) -> _Expansion:
        """What is found at φ, from the last mode.

        Entries off the Hessian's diagonal take P (P − 1)/2 parameter sets, all else 2P + 1. Where they are twice as
        many, they are computed after ``FRESH`` evaluations, again after as many, and where the search ends; till then
        the last correlations stand, and at first none.
        """
        model, size = self.at(phi), len(phi)
        # From the last mode always: from the start the search may end at another one, and evidences would not compare.
        mode = gauss_newton(model, self.observations, start=self.path)
        # One pass: more of them can run away where the posterior is very wide.
        smoother = posterior_linearisation(model, self.observations, mode, 1)
        last, age = (np.eye(size), 0) if self._known is None else (self._known.hessian, self._known.age)
        unit, pairs = STEP * np.eye(size), _pairs(size)
        whole = len(pairs) <= 2 * (2 * size + 1) or age >= FRESH
        shifts = np.concatenate([np.zeros((1, size)), unit, -unit, pairs[: len(pairs) if whole else 0]])
        over = smoother.path, smoother.covariance()
        evidence, paths = self._shifted(phi, shifts, *over, 1 + 2 * size)
        middle, up, down, both = np.split(evidence, [1, 1 + size, 1 + 2 * size])
        slope = (paths[:, 1 : 1 + size] - paths[:, 1 + size :]) / (2 * STEP)
        precision = 1 / self.sd**2
        gradient = phi * precision - (up - down) / (2 * STEP)
        alone = middle, up, precision - (up + down - 2 * middle) / STEP**2
        hessian = _whole_hessian(alone, both) if whole else _with_diagonal(last, alone[2])
        return _Expansion(
            phi=phi.tobytes(),
            value=0.5 * (phi**2 * precision).sum() - smoother.log_evidence.item(),
            gradient=gradient,
            hessian=hessian,
            path=mode.path,  # it obeys the dynamics, which the posterior's mean does not quite
            over=over,
            alone=alone,
            moves=(slope, over[1].diagonal(dim1=-2, dim2=-1).numpy()),
            age=0 if whole else age + 1,
        )

    def around(self, phi: np.ndarray, others: np.ndarray) -> tuple[np.ndarray, Tensor]:
        """Log-evidence (B,) at ``others`` (B, P), linearised over the posterior at φ, and where their modes are about.

        Paths are (B, T, D).
        """
        model = self.at(phi)
        mode = gauss_newton(model, self.observations, start=self.path)
        smoother = posterior_linearisation(model, self.observations, mode, 1)
        covariance = smoother.covariance()
        evidence, paths = self._shifted(phi, others - phi, smoother.path, covariance, len(others))
        return evidence, mode.path + torch.as_tensor(paths[0])

    def moved(self, step: np.ndarray) -> Tensor:
        """By how much the mean path (T, D) moves with a ``step`` (P,) of φ from where it was evaluated last."""
        assert self._known is not None
        return torch.as_tensor(np.einsum("p,ptd->td", step, self._known.moves[0][0]))

    def scatter(self, covariance: np.ndarray) -> np.ndarray:
        """Squared error (D,), as a share, of a state's variance where one φ is drawn, of a ``covariance`` C (P, P).

        With slopes J of the mean path, φ adds a share b = ⟨J C Jᵀ / P⟩ to a variance P (Kass & Steffey 1989, JASA 84,
        717), an average over rows, and one draw of it tells b up to √2 b. With slopes of a draw's way from the mean,
        that is √P u for a u that stays, the same average is a quarter of the variance v² of log P: 2 b² + v².
        """
        assert self._known is not None
        slopes, variance = self._known.moves
        added = np.einsum("sptd,pq,sqtd->std", slopes, covariance, slopes, optimize=True)
        share = np.divide(added, variance, out=np.zeros_like(added), where=variance > 0).mean(1)
        return np.nan_to_num(2 * share[0] ** 2 + 4 * share[1], nan=np.inf)

    def _shifted(
        self, phi: np.ndarray, shifts: np.ndarray, path: Tensor, covariance: Tensor, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Log-evidence (B,) at φ + ``shifts`` (B, P), all linearised over N(path, covariance).

        And of the first ``count`` sets mean paths, in deviations from ``path``, and draws from those, (2, count, T, D).
        """
        slopes = self._slopes_of_means(phi, path, covariance)
        found, paths = np.empty(len(shifts)), np.empty((2, count, *path.shape))
        at_once = max(1, min(SETS_AT_ONCE, ROWS_AT_ONCE // len(self.observations)))
        # Sets of the same transitions one after the other, whose fits are those of the sets before.
        order = np.lexsort((shifts * slopes[0]).T)
        shared: list[tuple[np.ndarray, SharedMeans]] = [(np.empty(0), SharedMeans(self.parameters.model))] * 2
        for some in np.array_split(order, -(-len(shifts) // at_once)):
            centre, around = (each.expand(len(some), *each.shape) for each in (path, covariance))
            own = [shifts[some] * moves for moves in slopes]
            shared = [self._shared_means(phi, *each) for each in zip(own, shared, strict=True)]
            linear = fit_linear(
                self.at(phi + shifts[some]), self.observations, centre, around, *(means for _, means in shared)
            )
            mean, found[some], drawn = mean_and_evidence(linear, noise=self._noise, repair=REPAIR)
            wanted = some < count
            paths[:, some[wanted]] = mean[wanted], drawn[wanted]
        return found, paths

    def _slopes_of_means(self, phi: np.ndarray, path: Tensor, covariance: Tensor) -> list[np.ndarray]:
        """Which parameters move the means of transitions, and of emissions: (P,) each, 0 of those that do not."""
        each = np.zeros((1 + len(self.free), len(phi)))
        for row, index in zip(each[1:], self.slices, strict=True):
            row[index] = STEP
        path, covariance = (values.expand(len(each), *values.shape) for values in (path, covariance))
        moving = moved_means(self.at(phi + each), path, covariance)
        return [each.T @ np.where(those, 1 / STEP, 0.0) for those in moving]

    def _shared_means(
        self, phi: np.ndarray, shifts: np.ndarray, last: tuple[np.ndarray, SharedMeans]
    ) -> tuple[np.ndarray, SharedMeans]:
        """The fewest ``shifts`` (U, P) that have all means at φ + ``shifts`` (B, P), with fits of the ``last`` ones."""
        fewer, number = np.unique(shifts + 0.0, axis=0, return_inverse=True)
        same = np.array_equal(fewer, last[0])
        means = last[1] if same else SharedMeans(self.at(phi + fewer))
        return fewer, replace(means, number=torch.as_tensor(number))


def _pairs(size: int) -> np.ndarray:
    """Shifts (P (P − 1)/2, P) of two parameters up."""
    unit = STEP * np.eye(size)
    first, second = np.triu_indices(size, 1)
    return unit[first] + unit[second]


def _whole_hessian(alone: tuple[np.ndarray, np.ndarray, np.ndarray], evidence: np.ndarray) -> np.ndarray:
    """All entries (P, P), of what is known of parameters ``alone`` and the log-evidence with two up, (P (P − 1)/2,)."""
    middle, up, diagonal = alone
    hessian = np.diag(diagonal)
    first, second = np.triu_indices(len(up), 1)
    hessian[first, second] = hessian[second, first] = -(evidence - up[first] - up[second] + middle) / STEP**2
    return hessian


def _with_diagonal(hessian: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """A Hessian (P, P) with another ``diagonal`` (P,) and its own correlations."""
    ratio = np.sqrt(np.abs(diagonal) / np.maximum(np.abs(np.diagonal(hessian)), np.finfo(float).tiny))
    found = ratio[:, None] * hessian * ratio
    np.fill_diagonal(found, diagonal)
    return found
