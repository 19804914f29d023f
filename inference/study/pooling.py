"""Partial pooling: a hierarchical normal model over estimates of trials that have standard errors of their own.

    y_i = μ_{c(i)} + Σ_g u_{g, z_g(i)} + e_i,    u_{g,j} ~ N(0, τ_g²),    e_i ~ N(0, τ_0² + s_i²)

y_i is a trial's estimate, s_i its error, c(i) its condition, z_g(i) its subject, its session, its session under this
condition, and its subject under this condition (the effect of the condition then differs between subjects). τ_0 is the
sd between trials of one cell. A grouping is left out where the design cannot tell it from another one.
Priors: μ flat, each τ half-normal (Gelman 2006, Bayesian Analysis 1, 515–534) of the scale

    subject                  sd of all y
    session                  sd of y about its subject's mean
    of trials, τ_0           twice that, as the sd of few trials is often much too small (measured: of four trials, 90 %
                             intervals of a difference then hold .93, else .80)
    subject, session × condition    the larger of
                             sd of y about subject and condition, over √2: an effect, which is the difference of two of
                             these, then differs between subjects about as much as trials of one cell do
                             upper 85 % limit, by χ², of the sd of the cells' means about subject and condition: where
                             trials are precise, the interval of a difference is then Student's, of one degree of
                             freedom less than there are subjects, which is exact

No sum of squares counts as less than the errors alone would leave, so that equal estimates have scales too.

Given τ all is Gaussian, and log p(y | τ) is known in closed form. The τ are integrated out by importance sampling on
Sobol points, half of them of the prior and half of a Student's t that is fitted to log τ, twice or more often. What is
needed of μ is a mixture of normals. Nothing is random: the same numbers give the same answer.

Shapes: n trials, C conditions, G sets of τ, q = C + all groups.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.special import logsumexp, ndtr, ndtri
from scipy.stats import chi2, multivariate_t, qmc

SETS, DF, WIDENING = 1024, 5.0, 1.3
"""Sets of τ; degrees of freedom of Student's t, and by how much it is wider than the sets' own spread."""
MIN_ROUNDS, MAX_ROUNDS, MIN_SHARE = 2, 12, 0.15
"""Fits of Student's t, until the effective number of sets is that share of all: two, but for very precise trials."""
MIN_SD = 1e-4
"""Of the scale: below it an sd counts as none."""
OF_TRIALS = 2.0
"""Of the scale: prior scale of the spread between trials."""
LIMIT = 0.15
"""Probability of a χ² below which the upper limit of an sd takes its sum of squares to be."""
MIN_TRIALS = 2  # for a scatter between trials


@dataclass(frozen=True)
class Mixture:
    """A quantity whose density is Σ_g w_g N(mean_g, sd_g²)."""

    weights: np.ndarray
    means: np.ndarray
    sds: np.ndarray

    @property
    def mean(self) -> float:
        """Of the mixture."""
        return float(self.weights @ self.means)

    @property
    def sd(self) -> float:
        """Of the mixture."""
        return float(np.sqrt(self.weights @ (self.sds**2 + (self.means - self.mean) ** 2)))

    def below(self, x: float) -> float:
        """Probability of a value under x."""
        return float(self.weights @ ndtr((x - self.means) / self.sds))

    def quantile(self, share: float) -> float:
        """Value with that probability below it."""
        ends = self.mean + 40 * (self.sd or 1.0) * np.array([-1.0, 1.0])
        return float(brentq(lambda x: self.below(x) - share, *ends, xtol=1e-9 * (ends[1] - ends[0])))

    @property
    def summary(self) -> dict[str, float]:
        """Mean, and the ends q05 and q95 of the 90 % interval."""
        return {"mean": self.mean, "q05": self.quantile(0.05), "q95": self.quantile(0.95)}

    @property
    def direction(self) -> float:
        """Probability of the more probable sign."""
        negative = self.below(0.0)
        return max(negative, 1 - negative)


@dataclass(frozen=True)
class Pooled:
    """Posterior of :func:`pool`.

    Attributes:
        levels: the C conditions.
        weights: (G,) of the sets of τ.
        means, covariances: (G, C) and (G, C, C) of μ.
        spreads: (G, 1 + groupings) τ, that between trials first.
        groupings: names of the others.
        confounded: of :func:`confounded`.
    """

    levels: tuple[str, ...]
    weights: np.ndarray
    means: np.ndarray
    covariances: np.ndarray
    spreads: np.ndarray
    groupings: tuple[str, ...]
    confounded: str

    def average(self, level: str) -> Mixture:
        """Of a condition's μ."""
        k = self.levels.index(level)
        return Mixture(self.weights, self.means[:, k], np.sqrt(self.covariances[:, k, k]))

    def new_trial(self, level: str) -> Mixture:
        """Of a further trial's true value, of a subject and a session that were not seen."""
        own = self.average(level)
        return Mixture(own.weights, own.means, np.sqrt(own.sds**2 + (self.spreads**2).sum(-1)))

    def difference(self, first: str, second: str) -> Mixture:
        """Of μ_second − μ_first."""
        a, b = (self.levels.index(level) for level in (first, second))
        variance = self.covariances[:, a, a] + self.covariances[:, b, b] - 2 * self.covariances[:, a, b]
        return Mixture(self.weights, self.means[:, b] - self.means[:, a], np.sqrt(variance))


def pool(
    estimates: np.ndarray,
    errors: np.ndarray,
    condition: Sequence[str],
    subject: Sequence[str],
    session: Sequence[str],
    sets: int = SETS,
) -> Pooled:
    """Pool estimates y (n,) with standard errors s (n,) of trials; labels are (n) each.

    Raises ValueError for fewer than two trials, or numbers that are not finite.
    """
    y, s = np.asarray(estimates, float), np.asarray(errors, float)
    if len(y) < MIN_TRIALS or not (np.isfinite(y).all() and np.isfinite(s).all()):
        raise ValueError(f"expected {MIN_TRIALS} trials or more with finite estimates, got {y} with errors {s}")
    middle = float(y.mean())
    levels, own = np.unique(np.asarray(condition, str), return_inverse=True)
    groups, all_groups = groupings(condition, subject, session), _all_groups(condition, subject, session)
    whose = {name: all_groups[name] for name in ("subject", "session")}
    scale, *others = _prior_scales(y, s, own, whose, groups)
    log_scale = np.log([OF_TRIALS * scale, *others]) - np.log(scale)
    y, s = (y - middle) / scale, np.maximum(s / scale, MIN_SD)
    design = _indicators(own, *groups.values())
    sizes = np.array([z.max() + 1 for z in groups.values()], int)
    log_tau = _prior_points(log_scale, sets)
    log_weights, *_ = _given(log_tau, y, s, design, len(levels), sizes)
    for done in range(1, MAX_ROUNDS + 1):
        log_tau, importance = _adapted(log_tau, log_weights, log_scale)
        evidence, means, covariances = _given(log_tau, y, s, design, len(levels), sizes)
        log_weights = evidence + importance
        weights = np.exp(log_weights - logsumexp(log_weights))
        if done >= MIN_ROUNDS and 1 / (weights**2).sum() >= MIN_SHARE * sets:
            break
    return Pooled(
        tuple(levels.tolist()),
        weights,
        middle + scale * means,
        scale**2 * covariances,
        scale * np.exp(log_tau),
        tuple(groups),
        confounded(condition, subject, session),
    )


def groupings(condition: Sequence[str], subject: Sequence[str], session: Sequence[str]) -> dict[str, np.ndarray]:
    """Group (n,) of each trial by each grouping that the design tells from conditions, trials, and the ones before."""
    found: dict[str, np.ndarray] = {}
    known = [_numbered(condition), np.arange(len(condition))]
    for name, number in _all_groups(condition, subject, session).items():
        if number.max() > 0 and not any(np.array_equal(number, other) for other in known):
            found[name] = number
            known.append(number)
    return found


def confounded(condition: Sequence[str], subject: Sequence[str], session: Sequence[str]) -> str:
    """What each condition has one of its own of, "subject" or "session", so that its effect may be theirs; else ""."""
    own, groups = _numbered(condition), _all_groups(condition, subject, session)
    same = [name for name in ("subject", "session") if np.array_equal(groups[name], own)]
    return same[0] if same and own.max() > 0 else ""


def _all_groups(condition: Sequence[str], subject: Sequence[str], session: Sequence[str]) -> dict[str, np.ndarray]:
    """Group (n,) of each trial by each grouping; sessions of two subjects differ even if they share a name."""
    cells = {"subject × condition": zip(subject, condition, strict=True), "session": zip(subject, session, strict=True)}
    labels = {"subject": subject, **cells, "session × condition": zip(subject, session, condition, strict=True)}
    return {name: _numbered(each) for name, each in labels.items()}


def _numbered(labels: Iterable[Hashable]) -> np.ndarray:
    """Groups numbered in the order in which they come."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(label, len(numbers)) for label in labels])


def _prior_scales(
    y: np.ndarray, s: np.ndarray, own: np.ndarray, whose: dict[str, np.ndarray], groups: dict[str, np.ndarray]
) -> list[float]:
    """Sd of y about its subject's mean, and the prior scale of each of the groups, in the unit of y."""
    spread = float(y.std())
    s = np.maximum(s, 1e-9 * (np.abs(y).max() or 1.0))  # what is left of equal estimates by rounding is nothing
    squares, free = _left(y, s**2, whose["subject"])
    scale = float(np.sqrt(squares / len(y))) if free else max(spread, float(s.mean()))
    s = np.maximum(s, MIN_SD * scale)
    squares, free = _left(y, s**2, whose["subject"], own)
    of_effect = float(np.sqrt(squares / free / 2)) if free else scale / np.sqrt(2)
    scales = [scale]
    for name, cells in groups.items():
        if name in whose:
            scales.append(max(spread, scale) if name == "subject" else scale)
            continue
        _, first, count = np.unique(cells, return_index=True, return_counts=True)
        means, variance = np.bincount(cells, y) / count, np.bincount(cells, s**2) / count**2
        squares, free = _left(means, variance, whose[name.removesuffix(" × condition")][first], own[first])
        scales.append(max(of_effect, float(np.sqrt(squares / chi2.ppf(LIMIT, free)))) if free else of_effect)
    return scales


def _indicators(*groups: np.ndarray) -> np.ndarray:
    """Columns (n, q), one for each group of each grouping (n,): 1 for its trials."""
    return np.concatenate([np.eye(z.max() + 1)[z] for z in groups], axis=1)


def _left(y: np.ndarray, variance: np.ndarray, *groups: np.ndarray) -> tuple[float, int]:
    """Sum of squares that the groupings leave of y, no less than errors alone would; its degrees of freedom."""
    design = _indicators(*groups)
    fit, _, rank, _ = np.linalg.lstsq(design, y, rcond=None)
    free = len(y) - int(rank)
    return max(float(((y - design @ fit) ** 2).sum()), free * float(variance.mean())), free


def _given(
    log_tau: np.ndarray, y: np.ndarray, s: np.ndarray, design: np.ndarray, conditions: int, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence log p(y | τ) (G,) but for a constant, and mean (G, C) and covariance (G, C, C) of μ."""
    tau2 = np.exp(2 * log_tau)
    precision = 1 / (tau2[:, :1] + s**2)
    prior = np.concatenate([np.zeros((len(tau2), conditions)), np.repeat(1 / tau2[:, 1:], sizes, axis=1)], axis=1)
    squares = design[:, :, None] * design[:, None, :]
    matrix = np.tensordot(precision, squares, axes=1) + prior[:, :, None] * np.eye(design.shape[1])
    right = (precision * y) @ design
    covariance = np.linalg.inv(matrix)
    mean = np.einsum("gij,gj->gi", covariance, right)
    log_evidence = 0.5 * (np.log(precision).sum(-1) - precision @ y**2 + (right * mean).sum(-1))
    log_evidence -= 0.5 * np.linalg.slogdet(matrix)[1] + (sizes * log_tau[:, 1:]).sum(-1)
    return log_evidence, mean[:, :conditions], covariance[:, :conditions, :conditions]


@cache
def _points(dimensions: int, count: int) -> np.ndarray:
    """Sobol points (count, dimensions) within the unit cube, its faces left out."""
    points = qmc.Sobol(dimensions, scramble=True, rng=0).random(count)
    return np.clip(points, 1e-6, 1 - 1e-6)


@cache
def _student_points(dimensions: int, count: int) -> np.ndarray:
    """Points (count, dimensions) of the standard Student t with `DF` degrees of freedom."""
    points = _points(dimensions + 1, count)
    return np.sqrt(DF / chi2.ppf(points[:, -1:], DF)) * ndtri(points[:, :-1])


def _prior_points(log_scale: np.ndarray, count: int) -> np.ndarray:
    """Points log τ (G, d) of the prior, whose scales are e^log_scale (d,)."""
    return np.log(np.maximum(ndtri((1 + _points(len(log_scale), count)) / 2), MIN_SD)) + log_scale


def _adapted(log_tau: np.ndarray, log_weights: np.ndarray, log_scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """New points, half of the prior and half near those that weigh, and log prior − log of what they were drawn of."""
    count, dimensions = log_tau.shape
    weights = np.exp(log_weights - logsumexp(log_weights))
    centre = weights @ log_tau
    covariance = (log_tau - centre).T @ (weights[:, None] * (log_tau - centre))
    shape = WIDENING**2 * covariance + 1e-3 * np.eye(dimensions)
    near = centre + _student_points(dimensions, count // 2) @ np.linalg.cholesky(shape).T
    near = np.clip(near, np.log(MIN_SD) + log_scale, np.log(8.0) + log_scale)
    both = np.concatenate([near, _prior_points(log_scale, count - count // 2)])
    # The density of log τ is that of a half-normal times τ.
    own = both - log_scale
    prior = (0.5 * np.log(2 / np.pi) - 0.5 * np.exp(2 * own) + own).sum(-1)
    drawn = multivariate_t(centre, shape, df=DF).logpdf(both)
    return both, prior - np.logaddexp(prior, drawn)
