"""Parameters by marginal likelihood: noise scales, λ, σ_τ, σ_y, link lengths, when not given.

Maximises  log p(y | φ) + log p(φ)  over log-parameters φ = log(θ / θ_start), with p(φ) a wide
Gaussian around the start (a factor of e^±sd), by Newton's method in a trust region. The evidence
is that of the posterior-linearised model (:mod:`.posterior_linearisation`), which on planar arms
lies within about a nat of the SMC evidence. Gradient and Hessian come by finite differences
in one batch: all perturbed parameter sets share the posterior N(x̄, P) that the model is linearised
over, and run through one backward recursion together. Means that a parameter does not move are fitted once.
Link lengths are known a hundred times better than noise scales: a first-order or quasi-Newton method crawls here.

Under heavy tails the least squares that stand in for rows have the right gradient, but a Hessian whose sign may be
wrong: it serves the search. What is reported of parameters comes from differences of gradients, each at its own mode.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.smoothing.gauss_newton import gauss_newton, mean_and_evidence
from invdyn.inference.smoothing.posterior_linearisation import (
    SharedMeans,
    fit_linear,
    moved_means,
    posterior_linearisation,
)
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.observation.missing import is_gaussian
from invdyn.models.state_space import StateSpaceModel

STEP = 2e-3
"""Finite-difference step of a log-parameter: lengths are known to a part in a thousand, and the evidence is smooth."""

PATIENCE = 6
"""Iterations without a gain that end the search; rejected ones shrink the trust region fourfold each."""

GRADIENT_STEP, MAX_GRADIENT_STEP = 0.25, 0.1
"""How far the gradient is looked at from an optimum: in standard deviations of a parameter, and of its logarithm."""

LEFT, HEAVY_MIN_GAIN = 0.05, 5e-3
"""The search ends where one Newton step is left. From d posterior sds away such a step of a
logarithm of sd s ends some d² s from the optimum: its gain of ½ d² nats is at most ``LEFT`` / s, for a tenth of an sd.
Under heavy tails no step is left, and at most so many nats."""

MAX_PREDICTED = 0.1
"""Nats that a last step may gain unseen. Where it should gain more, its end is evaluated, and taken if it is better."""

FRESH = 3
"""Evaluations between two whole Hessians of many parameters: of fifteen a whole one costs as much as four others."""

SETS_AT_ONCE, ROWS_AT_ONCE = 32, 20_000
"""Parameter sets that are computed at once, and their rows: more are hardly quicker, and take memory."""

NOT_FINITE = (
    "the fit cannot start: expected a finite evidence with finite slopes, got none; look for places far from all "
    "others, such as a missing point written as 0, and check units and the body's lengths"
)


@dataclass(frozen=True)
class Free:
    """One parameter to be fitted: its entries separately, or ``tied`` to one common factor.

    ``sd`` is the prior's standard deviation of log(θ/θ_start); ``entries`` the flat indices that are
    free, all of them by default. One that may be negative has a ``unit`` instead, in its own measure: it is
    θ_start + unit φ, and φ has the prior.
    """

    name: str
    tied: bool = False
    sd: float = 2.0
    entries: tuple[int, ...] | None = None
    unit: float | None = None

    def indices(self, size: int) -> tuple[int, ...]:
        """Flat indices of the free entries among ``size``."""
        return tuple(range(size)) if self.entries is None else self.entries


M = TypeVar("M", bound=StateSpaceModel)
"""The class of the model, which is kept."""


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


class LogParameters(Generic[M]):
    """A model's free parameters as one vector φ = log(θ/θ_start), whose prior is N(0, diag sd²).

    Attributes:
        labels: (P) names of φ's entries, such as "body.mass[0]"; without an index where there is one only.
        sd: (P,) of the prior.
    """

    def __init__(self, model: M, free: Sequence[Free]):
        self.model, self.free = model, tuple(free)
        for name in (f.name for f in self.free if model.parameters[f.name].ndim == 0):
            raise ValueError(
                f"parameter {name}: expected a tensor of one entry or more to fit, such as (1,), got a number"
            )
        entries = [f.indices(model.parameters[f.name].numel()) for f in self.free]
        sizes = [1 if f.tied else len(own) for f, own in zip(self.free, entries, strict=True)]
        self.slices = np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])
        self.sd = np.concatenate([np.full(n, f.sd) for n, f in zip(sizes, self.free, strict=True)])
        self.labels = [
            f.name if size == 1 else f"{f.name}[{k}]"
            for f, own, size in zip(self.free, entries, sizes, strict=True)
            for k in own[:size]
        ]

    def of(self, values: Mapping[str, Tensor]) -> np.ndarray:
        """φ (P,) of parameters' ``values`` by name, their mean where entries are tied; 0 where there are none."""
        phi = np.zeros(len(self.sd))
        for f, index in zip(self.free, self.slices, strict=True):
            if (value := values.get(f.name)) is None:
                continue
            start = self.model.parameters[f.name]
            off = (value / start).log() if f.unit is None else (value - start) / f.unit
            own = off.flatten()[list(f.indices(start.numel()))].double()
            own = torch.where(own.isfinite(), own, torch.nan)  # entries that are 0, as of a root, tell nothing
            phi[index] = own.nanmean().item() if f.tied else own.numpy()
        return np.nan_to_num(phi)

    def at(self, phi: Tensor) -> M:
        """The model at φ (P,), or at a batch of them (B, P) with parameters (B, 1, own shape); differentiable."""
        values = {}
        for f, index in zip(self.free, self.slices, strict=True):
            start = self.model.parameters[f.name]
            own = phi[..., index].to(start)
            place = own.new_zeros(len(index), start.numel())
            free = list(f.indices(start.numel()))
            place[torch.arange(len(index)) if len(index) > 1 else 0, free] = 1.0
            change = own @ place
            if phi.ndim == 2:
                change = change.unsqueeze(-2)
            change = change.reshape(*change.shape[:-1], *start.shape)
            values[f.name] = start * change.exp() if f.unit is None else start + f.unit * change
        return self.model.replace(**values)


class Objective(Generic[M]):
    """Negative log-posterior of φ with gradient and Hessian, and a warm-started path."""

    def __init__(self, model: M, observations: Tensor, free: Sequence[Free], start: Tensor | None):
        self.observations, self.parameters = observations, LogParameters(model, free)
        self.free, self.slices, self.sd = self.parameters.free, self.parameters.slices, self.parameters.sd
        self.path = start
        self.heavy = not is_gaussian(model.emission(observations.new_zeros(1, model.state_dim), torch.arange(1)))
        self._known: tuple[bytes, tuple[float, np.ndarray, np.ndarray]] | None = None
        # How mean path and a draw's way from it move with φ (2, P, T, D), and the states' variances (T, D), at the last
        # evaluation.
        self._moves: tuple[np.ndarray, np.ndarray] | None = None
        self._noise = np.random.default_rng(0).standard_normal((len(observations), model.state_dim))
        # The last Hessian all of whose entries were computed, and how many evaluations ago that was.
        self._whole: np.ndarray | None = None
        self._age = 0

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
        if self._known is None or self._known[0] != phi.tobytes():
            return None
        _, gradient, hessian = self._known[1]
        values, vectors = np.linalg.eigh(hessian)
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
        if not self.heavy:
            if self._age == 0:
                return hessian
            self._whole = None
            with diverging():
                return self._expand(phi)[2]
        steps = GRADIENT_STEP / np.sqrt(np.maximum(np.abs(np.diagonal(hessian)), 1 / self.sd**2))
        rows, found = np.zeros_like(hessian), self.path
        try:
            for k, step in enumerate(np.clip(steps, STEP, MAX_GRADIENT_STEP)):
                self.path = found
                with diverging():
                    rows[k] = (self._expand(phi + step * np.eye(len(phi))[k])[1] - gradient) / step
        except Diverged:
            rows = hessian
        self.path = found
        return (rows + rows.T) / 2

    def _evaluate(self, phi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        if self._known is None or self._known[0] != phi.tobytes():
            reached = self.path
            try:
                with diverging():
                    found = self._expand(phi)
                if not all(np.isfinite(each).all() for each in found):
                    raise Diverged(NOT_FINITE)
            except Diverged:
                if self._known is None:
                    raise
                # Out of the linearisation's reach: the trust region shrinks.
                self.path, self._whole = reached, None
                return 1e10, np.zeros_like(phi), np.eye(len(phi))
            self._known = (phi.tobytes(), found)
        return self._known[1]

    def _expand(self, phi: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Value, gradient and Hessian at φ.

        Entries off the Hessian's diagonal take P (P − 1)/2 parameter sets, all else 2P + 1. Where they are twice as
        many, they are computed every ``FRESH`` evaluations; in between, the last correlations stand.
        """
        model, size = self.at(phi), len(phi)
        # From the last mode always: from the start the search may end at another one, and evidences would not compare.
        mode = gauss_newton(model, self.observations, start=self.path)
        # One pass: more of them can run away where the posterior is very wide.
        smoother = posterior_linearisation(model, self.observations, mode, 1)
        self.path = mode.path  # it obeys the dynamics, which the posterior's mean does not quite

        unit = STEP * np.eye(size)
        few = size * (size - 1) / 2 <= 2 * (2 * size + 1)
        whole = few or self._whole is None or self._age >= FRESH
        first, second = np.triu_indices(size if whole else 0, 1)
        shifts = np.concatenate([np.zeros((1, size)), unit, -unit, unit[first] + unit[second]])
        covariance = smoother.covariance()
        evidence, paths = self._shifted(phi, shifts, smoother.path, covariance, 1 + 2 * size)
        middle, up, down, pairs = np.split(evidence, [1, 1 + size, 1 + 2 * size])
        slope = (paths[:, 1 : 1 + size] - paths[:, 1 + size :]) / (2 * STEP)
        self._moves = slope, covariance.diagonal(dim1=-2, dim2=-1).numpy()
        precision = 1 / self.sd**2
        gradient = phi * precision - (up - down) / (2 * STEP)
        diagonal = precision - (up + down - 2 * middle) / STEP**2
        if whole or self._whole is None:
            hessian = np.diag(diagonal)
            hessian[first, second] = hessian[second, first] = -(pairs - up[first] - up[second] + middle) / STEP**2
            self._whole, self._age = hessian, 0
        else:
            hessian, self._age = _with_diagonal(self._whole, diagonal), self._age + 1
        value = smoother.log_evidence.item() - 0.5 * (phi**2 * precision).sum()
        return -value, gradient, hessian

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
        assert self._moves is not None
        return torch.as_tensor(np.einsum("p,ptd->td", step, self._moves[0][0]))

    def scatter(self, covariance: np.ndarray) -> np.ndarray:
        """Squared error (D,), as a share, of a state's variance where one φ is drawn, of a ``covariance`` C (P, P).

        With slopes J of the mean path, φ adds a share b = ⟨J C Jᵀ / P⟩ to a variance P (Kass & Steffey 1989, JASA 84,
        717), an average over rows, and one draw of it tells b up to √2 b. With slopes of a draw's way from the mean,
        that is √P u for a u that stays, the same average is a quarter of the variance v² of log P: 2 b² + v².
        """
        assert self._moves is not None
        slopes, variance = self._moves
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
        found: list[np.ndarray] = []
        paths: list[np.ndarray] = []
        at_once = max(1, min(SETS_AT_ONCE, ROWS_AT_ONCE // len(self.observations)))
        for some in np.array_split(shifts, -(-len(shifts) // at_once)):
            centre, around = (each.expand(len(some), *each.shape) for each in (path, covariance))
            moved, seen = (self._shared_means(phi, some, each) for each in slopes)
            linear = fit_linear(self.at(phi + some), self.observations, centre, around, moved, seen)
            mean, evidence, drawn = mean_and_evidence(linear, noise=self._noise)
            found.append(evidence)
            paths.append(np.stack([mean, drawn])[:, : max(0, count - sum(map(len, found[:-1])))])
        return np.concatenate(found), np.concatenate(paths, 1)

    def _slopes_of_means(self, phi: np.ndarray, path: Tensor, covariance: Tensor) -> list[np.ndarray]:
        """Which parameters move the means of transitions, and of emissions: (P, 1 + free), not 0 where they do."""
        each = np.zeros((1 + len(self.free), len(phi)))
        for row, index in zip(each[1:], self.slices, strict=True):
            row[index] = STEP
        path, covariance = (values.expand(len(each), *values.shape) for values in (path, covariance))
        moving = moved_means(self.at(phi + each), path, covariance)
        return [each.T @ np.where(those, 1 / STEP, 0.0) for those in moving]

    def _shared_means(self, phi: np.ndarray, shifts: np.ndarray, moves: np.ndarray) -> SharedMeans:
        """The fewest parameter sets that have all means at φ + ``shifts`` (B, P)."""
        fewer, number = np.unique(shifts * moves + 0.0, axis=0, return_inverse=True)
        return SharedMeans(self.at(phi + fewer), torch.as_tensor(number))


def _with_diagonal(hessian: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """A Hessian (P, P) with another ``diagonal`` (P,) and its own correlations."""
    ratio = np.sqrt(np.abs(diagonal) / np.maximum(np.abs(np.diagonal(hessian)), np.finfo(float).tiny))
    found = ratio[:, None] * hessian * ratio
    np.fill_diagonal(found, diagonal)
    return found


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
    model = model.to(dtype=torch.float64, device="cpu")
    observations = observations.detach().cpu().double()
    model.check_names(f.name for f in free)
    if not free:
        smoother = posterior_linearisation(model, observations, gauss_newton(model, observations, start=start))
        none, evidence = np.zeros(0), smoother.log_evidence.item()
        return Fit(
            model, evidence, smoother.path, {}, True, none, np.zeros((0, 0)), evidence, np.zeros(model.state_dim)
        )
    objective = Objective(model, observations, free, start)
    # Once: copies with other numbers inherit the result.
    check_model(model, observations, needs=("gaussian_transition", "emission_of_state"))

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
