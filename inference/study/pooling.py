"""Partial pooling: a mixed linear model of estimates of trials that have standard errors of their own.

    y_i = μ_{c(i)} + Σ_g u_{g, z_g(i)} + e_i,    u_{g,j} ~ N(0, θ_g),    e_i ~ N(0, θ_0 + s_i²)

y_i is a trial's estimate, s_i its error, c(i) its condition, z_g(i) its subject, its session, its session under this
condition, and its subject under this condition (the effect of the condition then differs between subjects). θ_0 is the
variance between trials of one cell. A grouping is left out where the design cannot tell it from another one.

The variances maximise the restricted likelihood (Patterson & Thompson 1971, Biometrika 58, 545–554), by Fisher scoring,

    θ ← max(0, θ + I⁻¹ S),    S_g = ½ (|Z_gᵀ P y|² − tr Z_gᵀ P Z_g),    I_gh = ½ |Z_gᵀ P Z_h|²,
    P = Σ⁻¹ − Σ⁻¹ X (Xᵀ Σ⁻¹ X)⁻¹ Xᵀ Σ⁻¹,    Z_0 = 1.

A combination kᵀμ is estimated by bᵀy, of variance V = bᵀΣb and slopes v_g = |Z_gᵀ b|², and has Student's distribution

    of ν = 2 V² / (vᵀ I⁻¹ v) degrees of freedom (Satterthwaite 1946, Biometrics Bulletin 2, 110–114),

of those θ that are not zero, as mixed models are read (Kuznetsova and others 2017, J. Statistical Software 82, 13). In
a balanced design that is a paired t test of the subjects' means. Where θ is estimated as zero, though, few subjects
cannot tell that it is, and intervals without it are too narrow: effects are found falsely in 8 % of studies of three
subjects, and in 13 % of two. So a tail is the larger of two: that one, and Student's of all θ after one more step,
V + vᵀ I⁻¹ S, in which variances may be negative: the t test again. Where each condition has one trial, θ is that of
all trials about one mean.

Shapes: n trials, C conditions, G groupings, q = C + all groups, 1 + G variances.
"""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

MAX_STEPS, SETTLED = 200, 1e-9
"""Of Fisher scoring; the largest change of θ, in the estimates' variance, that ends it."""
SINGULAR = 1e-9
"""Share of the largest information below which variances count as not told apart."""
MIN_SD = 1e-4
"""Of the estimates' sd: below it an error counts as none."""
MIN_TRIALS = 2  # for a scatter between trials


@dataclass(frozen=True)
class Estimate:
    """A quantity whose tails are the larger ones of two Student distributions about one mean.

    Attributes:
        mean: of both.
        sds, freedom: (2,) scales and degrees of freedom.
    """

    mean: float
    sds: np.ndarray
    freedom: np.ndarray

    def below(self, x: float) -> float:
        """Probability of a value under x."""
        tail = float(student.sf(abs(x - self.mean) / self.sds, self.freedom).max())
        return tail if x < self.mean else 1 - tail

    def quantile(self, share: float) -> float:
        """Value with that probability below it."""
        far = float((self.sds * student.isf(min(share, 1 - share), self.freedom)).max())
        return self.mean + (far if share > 0.5 else -far)

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
    """Answer of :func:`pool`.

    Attributes:
        levels: the C conditions.
        means: (C,) of μ.
        weights: (n, C) b of each.
        errors: (n,) s, no less than MIN_SD allows.
        groups: (q − C, n) indicators of all groups.
        owner: (q − C,) number of each group's variance, from 1.
        variances: (1 + G,) θ, that between trials first.
        score, information: (1 + G,) S and (1 + G, 1 + G) I at θ.
        confounded: of :func:`confounded`.
    """

    levels: tuple[str, ...]
    means: np.ndarray
    weights: np.ndarray
    errors: np.ndarray
    groups: np.ndarray
    owner: np.ndarray
    variances: np.ndarray
    score: np.ndarray
    information: np.ndarray
    confounded: str

    def average(self, level: str) -> Estimate:
        """Of a condition's μ."""
        return self._combined(self._one(level))

    def new_trial(self, level: str) -> Estimate:
        """Of a further trial's true value, of a subject and a session that were not seen."""
        return self._combined(self._one(level), 1.0)

    def difference(self, first: str, second: str) -> Estimate:
        """Of μ_second − μ_first."""
        return self._combined(self._one(second) - self._one(first))

    def _one(self, level: str) -> np.ndarray:
        return np.equal(self.levels, level).astype(float)

    def _combined(self, k: np.ndarray, further: float = 0.0) -> Estimate:
        """kᵀμ, and ``further`` times a new draw of all groups and trials."""
        b = self.weights @ k
        slopes = further + np.array([b @ b, *_summed((self.groups @ b) ** 2, self.owner, len(self.variances) - 1)])
        inside = self.variances > 0
        some, whole = (_inverse(self.information, each) for each in (inside, inside | True))
        own = b**2 @ self.errors**2 + (slopes - further) @ self.variances + further * self._of_trials(whole)
        step = max(own + slopes @ whole @ self.score, 0.0)
        spread = np.array([slopes @ some @ slopes, slopes @ whole @ slopes])
        freedom = np.divide(2 * own**2, spread, out=np.full(2, np.inf), where=spread > 0)
        return Estimate(float(self.means @ k), np.sqrt([own, max(step, 1e-12 * own)]), np.maximum(freedom, 1.0))

    def _of_trials(self, inverse: np.ndarray) -> float:
        """Mean of Σθ ≥ 0 by a normal density about one step on, as an estimate of zero is no knowledge that it is."""
        sd = float(np.sqrt(inverse.sum()))
        if sd == 0:
            return float(self.variances.sum())
        z = float((self.variances + inverse @ self.score).sum()) / sd
        return sd * (z + float(np.exp(norm.logpdf(z) - norm.logcdf(z))))


def pool(
    estimates: np.ndarray, errors: np.ndarray, condition: Sequence[str], subject: Sequence[str], session: Sequence[str]
) -> Pooled:
    """Pool estimates y (n,) with standard errors s (n,) of trials; labels are (n) each.

    Raises ValueError for fewer than two trials, or numbers that are not finite.
    """
    y, s = np.asarray(estimates, float), np.asarray(errors, float)
    if len(y) < MIN_TRIALS or not (np.isfinite(y).all() and np.isfinite(s).all()):
        raise ValueError(f"expected {MIN_TRIALS} trials or more with finite estimates, got {y} with errors {s}")
    middle, levels = float(y.mean()), np.unique(np.asarray(condition, str))
    least = 1e-9 * (np.abs(y).max() or 1.0)  # what is left of equal estimates by rounding is nothing
    scale = max(float(y.std()), float(s.mean()), least)
    s = np.maximum(s, max(MIN_SD * scale, least))
    groups = groupings(condition, subject, session)
    design = [np.asarray(condition, str) == levels[:, None]]
    design += [np.arange(each.max() + 1)[:, None] == each for each in groups.values()]
    owner = np.repeat(np.arange(len(design)), [len(each) for each in design])
    whole = np.concatenate(design).astype(float)
    numbers, kept = ((y - middle) / scale, s / scale), owner > 0
    if len(y) > len(levels):
        fit = _restricted(*numbers, whole, owner)
    else:
        null = _restricted(*numbers, np.ones((1, len(y))), np.zeros(1, int))
        fit = replace(_at(null.variances, *numbers, whole, owner), score=null.score, information=null.information)
    return Pooled(
        tuple(levels.tolist()),
        middle + scale * fit.means,
        fit.weights,
        s,
        whole[kept],
        owner[kept],
        scale**2 * fit.variances,
        fit.score / scale**2,
        fit.information / scale**4,
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


@dataclass(frozen=True)
class _Fit:
    """Restricted log-likelihood at θ, but for a constant, with the numbers of :class:`Pooled`."""

    log: float
    means: np.ndarray
    weights: np.ndarray
    variances: np.ndarray
    score: np.ndarray
    information: np.ndarray


def _restricted(y: np.ndarray, s: np.ndarray, design: np.ndarray, owner: np.ndarray) -> _Fit:
    """Its maximum over θ ≥ 0, of indicators (q, n) of conditions and groups, each with its owner's number (q,)."""
    count = 1 + int(owner.max())
    fit = _at(np.full(count, 1 / count), y, s, design, owner)
    for _ in range(MAX_STEPS):
        free = (fit.variances > 0) | (fit.score > 0)
        newton = _inverse(fit.information, free) @ fit.score
        slope = np.where(free, fit.score / np.maximum(fit.information.diagonal(), 1e-12), 0.0)
        lengths = 0.5 ** np.arange(20)
        for step in (*np.outer(lengths, newton), *np.outer(lengths, slope)):  # the second leads upwards at a bound too
            tried = _at(np.maximum(fit.variances + step, 0.0), y, s, design, owner)
            if tried.log >= fit.log:
                break
        else:
            return fit
        change, fit = np.abs(tried.variances - fit.variances).max(), tried
        if change < SETTLED:
            break
    return fit


def _at(variances: np.ndarray, y: np.ndarray, s: np.ndarray, design: np.ndarray, owner: np.ndarray) -> _Fit:
    """By Henderson's equations, in q rows: C = (Uᵀ D U + 1/θ)⁻¹ of D = 1 / (θ_0 + s²) and all groups that vary."""
    d, last = 1 / (variances[0] + s**2), len(variances) - 1
    there = (owner == 0) | (variances[owner] > 0)
    precision = np.where(owner > 0, 1 / np.where(variances[owner] > 0, variances[owner], 1.0), 0.0)
    a, a2, a3 = ((design * d**power) @ design.T for power in (1, 2, 3))
    inverse = np.zeros_like(a)
    matrix = (a + np.diag(precision))[np.ix_(there, there)]
    inverse[np.ix_(there, there)] = np.linalg.inv(matrix)
    blup = inverse @ design @ (d * y)
    residual = d * (y - blup @ design)  # P y
    across, ca2 = a - a @ inverse @ a, inverse @ a2  # Uᵀ P U
    twice = a2 - a @ ca2 - (a @ ca2).T + a @ ca2 @ inverse @ a  # Uᵀ P P U
    information = np.empty((last + 1, last + 1))
    of_groups = _summed(_summed(across**2, owner, last).T, owner, last)
    information[1:, 1:] = of_groups
    information[0, 1:] = information[1:, 0] = _summed(twice.diagonal(), owner, last)
    information[0, 0] = d @ d - 2 * (inverse * a3).sum() + (ca2 * ca2.T).sum()
    squares = [residual @ residual, *_summed((design @ residual) ** 2, owner, last)]
    traces = [d.sum() - (inverse * a2).sum(), *_summed(across.diagonal(), owner, last)]
    determinants = np.linalg.slogdet(matrix)[1] - np.log(d).sum() - np.log(precision[there & (owner > 0)]).sum()
    conditions = owner == 0
    return _Fit(
        float(-0.5 * (determinants + y @ residual)),
        blup[conditions],
        d[:, None] * (design.T @ inverse[:, conditions]),
        variances,
        0.5 * (np.array(squares) - np.array(traces)),
        0.5 * information,
    )


def _summed(values: np.ndarray, owner: np.ndarray, last: int) -> np.ndarray:
    """Sums over the rows of each owner from 1 to ``last``."""
    return np.stack([values[owner == g].sum(0) for g in range(1, last + 1)]) if last else values[:0]


def _inverse(information: np.ndarray, these: np.ndarray) -> np.ndarray:
    """Of the rows and columns ``these``, or its pseudo-inverse; zero in others."""
    size = np.sqrt(np.where(these, information.diagonal(), 0.0))
    size = np.divide(1, size, out=np.zeros_like(size), where=size > 0)
    return np.linalg.pinv(size[:, None] * information * size, rcond=SINGULAR, hermitian=True) * np.outer(size, size)
