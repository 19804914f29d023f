"""Causes on MuJoCo's engine: screened by differences of replays along the filter's path, then refined by filters.

The cubature filter (:mod:`.cubature_filter`) whitens a log under each size of the residual. A number ν of the model
adds columns to the innovations, by differences of one row's replays from the filtered states m_t,

    g_t = [f(m_t; ν + h) − f(m_t; ν − h)] / 2h,

and the evidence of a change is a Bayesian regression of innovations on columns, with a free scale of the noise
(:mod:`..sensitivity.evidence`). A cause is refined by Gauss–Newton: its numbers move to the regression's, the log is
filtered again with them, and evidence is that about the last point, for each size of the residual.

Shapes: T rows, O observations, D states, p numbers of a cause, G sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.special import logsumexp

from invdyn.diagnosis.engine.cubature_filter import Filtered, apart, cubature_filter
from invdyn.diagnosis.engine.effects import Candidate
from invdyn.diagnosis.engine.problem import EngineLog
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.evidence import Regression, regression
from invdyn.diagnosis.write_back.model_numbers import changed
from invdyn.models import EngineModel
from invdyn.models.divergence import Diverged

Prior = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Mean, sd and bounds of numbers."""


@dataclass(frozen=True)
class Cause:
    """Some effects at once, with their numbers.

    Attributes:
        effects: candidates; none for "no gap".
        point: (p,) the numbers with which the log was filtered.
        values, covariance: (p,), (p, p) their posterior under the most probable size.
        by_size_values, by_size_sds: (G, p) the same for each size.
        prior_mean, prior_sd: (p,).
        by_size: (G,) log evidence for each size of the residual, without its prior.
        kappa: (G,) factor on the noise.
        filtered: with the numbers at ``point``.
        columns: (G, T, O, p) about them.
    """

    effects: tuple[Candidate, ...]
    point: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    by_size_values: np.ndarray
    by_size_sds: np.ndarray
    prior_mean: np.ndarray
    prior_sd: np.ndarray
    by_size: np.ndarray
    kappa: np.ndarray
    filtered: Filtered
    columns: np.ndarray

    @property
    def key(self) -> str:
        """Of all effects."""
        return "+".join(each.key for each in self.effects)

    def log_evidence(self, log: EngineLog) -> float:
        """Sizes of the residual integrated out."""
        return float(logsumexp(self.by_size + log.regime.log_prior))

    def likely(self, log: EngineLog) -> int:
        """Number of the most probable size."""
        return int((self.by_size + log.regime.log_prior).argmax())

    def size(self, log: EngineLog) -> float:
        """The most probable residual, in typical torques."""
        return float(log.regime.sizes[self.likely(log)])


@dataclass(frozen=True)
class Screened:
    """A candidate next to a cause: log evidence, its numbers (n,), and d′ of a change of typical size."""

    effect: Candidate
    log_evidence: float
    values: np.ndarray
    dprime: float


def models_of(log: EngineLog, effects: Sequence[Candidate], values: np.ndarray) -> list[EngineModel]:
    """The log's models with the numbers (p,) of effects."""
    numbers = [(number.write, each.place) for each in effects for number in each.effect.numbers]
    if not numbers:
        return list(log.models)
    changes = [(write, place, float(value)) for (write, place), value in zip(numbers, values, strict=True)]
    compiled = changed(log.model.scene.model, changes)
    return [each.on(compiled) for each in log.models]


def filtered_with(log: EngineLog, effects: Sequence[Candidate], values: np.ndarray) -> Filtered:
    """The log filtered with the numbers (p,) of effects; raises Diverged where the simulation runs away."""
    return Filtered.joined([
        cubature_filter(log.with_residual(1.0, model), rows.numpy(), log.regime.sizes)
        for model, rows in zip(models_of(log, effects, values), log.rows, strict=True)
    ])  # fmt: skip


def _columns(
    log: EngineLog,
    effects: Sequence[Candidate],
    values: np.ndarray,
    sds: np.ndarray,
    filtered: Filtered,
    first: int = 0,
) -> np.ndarray:
    """What a unit of each number from the ``first`` on adds to the next state, (T − 1, G, D, p), within bounds."""
    sizes, count, dim = filtered.mean.shape
    means = np.split(filtered.mean, np.cumsum([len(rows) for rows in log.rows])[:-1], 1)

    def moved(values: np.ndarray) -> np.ndarray:
        parts = [
            model.moved(torch.as_tensor(mean[:, :-1]), torch.arange(1, mean.shape[1])).numpy().swapaxes(0, 1)
            for model, mean in zip(models_of(log, effects, values), means, strict=True)
        ]
        return apart(parts)

    out = []
    for at, number in list(enumerate(n for each in effects for n in each.effect.numbers))[first:]:
        low, high = (
            float(np.clip(values[at] + s * FIXED.engine_step * sds[at], number.low, number.high)) for s in (-1, 1)
        )
        ends = []
        for end in (low, high):
            other = values.copy()
            other[at] = end
            ends.append(moved(other))
        out.append(np.nan_to_num(ends[1] - ends[0]) / (high - low))
    return np.stack(out, -1) if out else np.zeros((count - 1, sizes, dim, 0))


def _priors(log: EngineLog, effects: Sequence[Candidate]) -> Prior:
    """Mean, sd and bounds (p,) of all numbers of some effects."""
    each = [candidate.priors(log.model.scene.model, log.sizes) for candidate in effects]
    numbers = [number for candidate in effects for number in candidate.effect.numbers]
    mean, sd = (np.concatenate([np.zeros(0), *(pair[k] for pair in each)]) for k in (0, 1))
    return mean, sd, np.array([n.low for n in numbers]), np.array([n.high for n in numbers])


def _regressed(
    log: EngineLog, filtered: Filtered, columns: np.ndarray, index: np.ndarray, prior: Prior
) -> list[Regression]:
    """Of H candidates, of columns ``index`` (H, p) of (G, T, O, J), one result a size."""
    sizes = len(columns)
    both = np.concatenate([filtered.innovations[..., None], columns], -1).reshape(sizes, -1, 1 + columns.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        gram = both.swapaxes(-1, -2) @ both
    none = np.zeros(len(index), int)
    log_det = filtered.log_det.sum(-1)
    mean, sd, low, high = prior
    pairs = zip(gram, log_det, strict=True)
    return [regression(g, index, none, mean, sd, low, high, log.count, d) for g, d in pairs]


def screened(log: EngineLog, cause: Cause, found: Sequence[Candidate]) -> list[Screened]:
    """Each candidate added to a cause, along the cause's filter; best first."""
    n, own = len(cause.point), [len(each.effect.numbers) for each in found]
    pieces, priors = [], []
    for each in found:
        mean, sd, low, high = _priors(log, (each,))
        values, sds = np.concatenate([cause.point, mean]), np.concatenate([cause.prior_sd, sd])
        pieces.append(_columns(log, (*cause.effects, each), values, sds, cause.filtered, n))
        priors.append((mean, sd, low, high))
    columns = np.concatenate([cause.columns, cause.filtered.columns(np.concatenate(pieces, -1))], -1)
    width, count = max(own, default=0) + n, len(found) + 1
    index = np.zeros((count, width), int)
    mean, sd = np.zeros((count, width)), np.ones((count, width))
    low, high = np.full((count, width), -np.inf), np.full((count, width), np.inf)
    index[:, :n] = 1 + np.arange(n)
    mean[:, :n], sd[:, :n] = cause.prior_mean - cause.point, cause.prior_sd
    at = 1 + n
    for k, (size, (middle, spread, lowest, highest)) in enumerate(zip(own, priors, strict=True)):
        part = slice(n, n + size)
        index[k, part] = at + np.arange(size)
        sd[k, part], low[k, part], high[k, part] = spread, lowest - middle, highest - middle
        at += size
    results = _regressed(log, cause.filtered, columns, index, (mean, sd, low, high))
    table = np.stack([each.log_evidence for each in results]) + log.regime.log_prior[:, None]
    kappa, out = results[int(table[:, -1].argmax())].kappa[-1], []
    norms = np.sqrt((columns[0] ** 2).sum((0, 1)))
    for k, each in enumerate(found):
        size = int(table[:, k].argmax())
        middle, spread, lowest, highest = priors[k]
        estimate = np.clip(middle + np.nan_to_num(results[size].mean[k, n : n + own[k]]), lowest, highest)
        clear = 0.67 * spread * norms[index[k, n : n + own[k]] - 1] / kappa
        out.append(Screened(each, float(logsumexp(table[:, k])), estimate, float(clear.max())))
    return sorted(out, key=lambda each: -each.log_evidence)


def refined(log: EngineLog, effects: Sequence[Candidate], values: np.ndarray) -> Cause:
    """The cause of some effects, from ``values`` (p,); raises Diverged where the simulation runs away there."""
    effects = tuple(effects)
    mean, sd, low, high = _priors(log, effects)
    low, high = (
        np.maximum(low, mean - log.rules.residual.max_prior_sds * sd),
        np.minimum(high, mean + log.rules.residual.max_prior_sds * sd),
    )
    best = _about(log, effects, np.clip(values, low, high))
    for _ in range(FIXED.engine_rounds if len(values) else 0):
        # Where the most probable size is settled, without a residual there may be a sharper estimate.
        for size in dict.fromkeys((best.likely(log), 0)):
            better = _better(log, best, np.clip(best.by_size_values[size], low, high), best.by_size_sds[size])
            if better is not None:
                break
        else:
            break
        best = better
    return replace(best, values=np.clip(best.values, low, high))


def _better(log: EngineLog, cause: Cause, target: np.ndarray, sds: np.ndarray) -> Cause | None:
    """The cause about its numbers on the way to a target, the nearest that gains; None where none does."""
    step = target - cause.point
    if (np.abs(step) < FIXED.engine_settled * sds).all():
        return None
    for half in range(FIXED.engine_shorter):
        try:
            tried = _about(log, cause.effects, cause.point + step / 4**half)
        except Diverged:
            continue
        if tried.log_evidence(log) > cause.log_evidence(log) + FIXED.engine_gain:
            return tried
    return None


def _about(log: EngineLog, effects: tuple[Candidate, ...], values: np.ndarray) -> Cause:
    """The cause about some values of its numbers."""
    mean, sd, low, high = _priors(log, effects)
    filtered = filtered_with(log, effects, values)
    columns = filtered.columns(_columns(log, effects, values, sd, filtered))
    index = 1 + np.arange(len(values))[None]
    prior = ((mean - values)[None], sd[None], (low - values)[None], (high - values)[None])
    results = _regressed(log, filtered, columns, index, prior)
    by_size = np.array([float(each.log_evidence[0]) for each in results])
    kappa = np.array([float(each.kappa[0]) for each in results])
    each_values = values + np.nan_to_num([each.mean[0] for each in results])
    covariances = np.array([each.covariance[0] for each in results])
    sds = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    here = int((by_size + log.regime.log_prior).argmax())
    return Cause(
        *(effects, values, each_values[here], covariances[here], each_values, sds, mean, sd, by_size, kappa),
        filtered,
        columns,
    )
