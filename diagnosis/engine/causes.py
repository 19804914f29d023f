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
from dataclasses import dataclass

import numpy as np
import torch
from scipy.special import logsumexp

from invdyn.diagnosis.catalogue.engine_effects import Candidate
from invdyn.diagnosis.catalogue.model_numbers import changed
from invdyn.diagnosis.engine.cubature_filter import Filtered, apart, cubature_filter
from invdyn.diagnosis.engine.problem import EngineLog
from invdyn.diagnosis.problem.cause import Scored
from invdyn.diagnosis.problem.unknowns import Unknowns
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.evidence import learned
from invdyn.diagnosis.sensitivity.screen import estimates, evidences, visibility
from invdyn.diagnosis.sensitivity.sensitivities import Hypothesis
from invdyn.models import EngineModel
from invdyn.models.divergence import Diverged


@dataclass(frozen=True)
class Cause(Scored):
    """Some effects at once, with their numbers.

    Attributes:
        effects: candidates; none for "no gap".
        unknowns: their numbers' priors.
        point: (p,) the numbers with which the log was filtered.
        values, covariance: (p,), (p, p) their posterior under the most probable size.
        by_size_values, by_size_sds: (G, p) the same for each size.
        log_evidence: sizes of the residual integrated out.
        by_size: (G,) log evidence with the prior weight of each size.
        kappa: (G,) factor on the noise.
        filtered: with the numbers at ``point``.
        columns: (G, T, O, p) about them.
        learned, far: as of :class:`.FittedHypothesis`.
    """

    effects: tuple[Candidate, ...]
    unknowns: Unknowns
    point: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    by_size_values: np.ndarray
    by_size_sds: np.ndarray
    log_evidence: float
    by_size: np.ndarray
    kappa: np.ndarray
    filtered: Filtered
    columns: np.ndarray
    learned: np.ndarray
    far: float

    @property
    def likely(self) -> int:
        """Number of the most probable size."""
        return int(self.by_size.argmax())


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
    unknowns: Unknowns,
    values: np.ndarray,
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
    for at in range(first, len(values)):
        step = FIXED.engine_step * unknowns.sd[at] * np.array([-1.0, 1.0])
        low, high = np.clip(values[at] + step, unknowns.lower[at], unknowns.upper[at])
        ends = []
        for end in (low, high):
            other = values.copy()
            other[at] = end
            ends.append(moved(other))
        out.append(np.nan_to_num(ends[1] - ends[0]) / (high - low))
    return np.stack(out, -1) if out else np.zeros((count - 1, sizes, dim, 0))


def unknowns_of(log: EngineLog, effects: Sequence[Candidate]) -> Unknowns:
    """Priors of all numbers of some effects."""
    each = [candidate.priors(log.model.scene.model, log.sizes) for candidate in effects]
    numbers = [number for candidate in effects for number in candidate.effect.numbers]
    mean, sd = (np.concatenate([np.zeros(0), *(pair[k] for pair in each)]) for k in (0, 1))

    far = log.rules.residual.max_prior_sds * sd
    lower = np.maximum([number.low for number in numbers], mean - far)
    upper = np.minimum([number.high for number in numbers], mean + far)
    names = tuple(f"{candidate.key}.{number.name}" for candidate in effects for number in candidate.effect.numbers)
    return Unknowns(names, (), mean, sd, lower, upper)


def _alone(candidate: Candidate, own: Unknowns) -> Hypothesis:
    """A candidate as what a screen compares: its numbers about the file's."""
    at_file = dict(zip(own.names, own.mean.tolist(), strict=True))
    lower, upper = (tuple((end - own.mean).tolist()) for end in (own.lower, own.upper))
    every = tuple(range(len(own.names)))
    sds = tuple(own.sd.tolist())
    return Hypothesis(candidate, at_file, own.names, sds, lower, upper, 0.0, every, None)  # type: ignore[arg-type]


def _gram(filtered: Filtered, columns: np.ndarray) -> np.ndarray:
    """Products (G, 1 + J, 1 + J) of innovations and columns (G, T, O, J)."""
    both = np.concatenate([filtered.innovations[..., None], columns], -1)
    both = both.reshape(len(columns), -1, both.shape[-1])
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(both.swapaxes(-1, -2) @ both)


def screened(log: EngineLog, cause: Cause, found: Sequence[Candidate]) -> list[Screened]:
    """Each candidate added to a cause, along the cause's filter; best first."""
    n, pieces, alone = len(cause.point), [], []
    for each in found:
        both = unknowns_of(log, (*cause.effects, each))
        values = np.concatenate([cause.point, both.mean[n:]])
        pieces.append(_columns(log, (*cause.effects, each), both, values, cause.filtered, n))
        alone.append(_alone(each, unknowns_of(log, (each,))))
    columns = np.concatenate([cause.filtered.columns(np.concatenate(pieces, -1)), cause.columns], -1)
    gram, log_det = _gram(cause.filtered, columns), cause.filtered.log_det.sum(-1)

    first = np.cumsum([0, *(len(each.free) for each in alone)])[:-1].tolist()
    results = evidences(gram, log_det, log.count, alone, first, cause.unknowns, cause.point)
    table = np.stack([each.log_evidence for each in results]) + log.regime.log_prior[:, None]
    kappa = float(results[int(table[:, -1].argmax())].kappa[-1])
    out = []
    for k, (each, own) in enumerate(zip(found, alone, strict=True)):
        values = np.array(list(estimates(own, results[int(table[:, k].argmax())], k).values()))
        dprime = visibility(gram[0], kappa, [own], [first[k]])
        out.append(Screened(each, float(logsumexp(table[:, k])), values, dprime))
    return sorted(out, key=lambda each: -each.log_evidence)


def refined(log: EngineLog, effects: Sequence[Candidate], values: np.ndarray) -> Cause:
    """The cause of some effects, from ``values`` (p,); raises Diverged where the simulation runs away there."""
    unknowns = unknowns_of(log, effects)
    known = np.where(np.isfinite(values), values, unknowns.mean)
    best = _about(log, tuple(effects), unknowns, unknowns.within(known))
    for _ in range(FIXED.engine_rounds if len(values) else 0):
        # Where the most probable size is settled, without a residual there may be a sharper estimate.
        for size in dict.fromkeys((best.likely, 0)):
            target = unknowns.within(best.by_size_values[size])
            better = _better(log, best, target, best.by_size_sds[size])
            if better is not None:
                break
        else:
            break
        best = better
    return best


def _better(log: EngineLog, cause: Cause, target: np.ndarray, sds: np.ndarray) -> Cause | None:
    """The cause about its numbers on the way to a target, the nearest that gains; None where none does."""
    step = target - cause.point
    if (np.abs(step) < FIXED.engine_settled * sds).all():
        return None
    for half in range(FIXED.engine_shorter):
        try:
            tried = _about(log, cause.effects, cause.unknowns, cause.point + step / 4**half)
        except Diverged:
            continue
        if tried.log_evidence > cause.log_evidence + FIXED.engine_gain:
            return tried
    return None


def _about(log: EngineLog, effects: tuple[Candidate, ...], unknowns: Unknowns, point: np.ndarray) -> Cause:
    """The cause about some values of its numbers."""
    filtered = filtered_with(log, effects, point)
    columns = filtered.columns(_columns(log, effects, unknowns, point, filtered))
    gram, log_det = _gram(filtered, columns), filtered.log_det.sum(-1)
    results = evidences(gram, log_det, log.count, [], [], unknowns, point)

    by_size = np.array([each.log_evidence[-1] for each in results]) + log.regime.log_prior
    kappa = np.array([each.kappa[-1] for each in results])
    each_values = point + np.nan_to_num([each.mean[-1] for each in results])
    covariances = np.array([each.covariance[-1] for each in results])
    here = int(by_size.argmax())
    values = unknowns.within(each_values[here])
    return Cause(
        effects,
        unknowns,
        point,
        values,
        covariances[here],
        each_values,
        np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1)),
        float(logsumexp(by_size)),
        by_size,
        kappa,
        filtered,
        columns,
        learned(covariances[here], unknowns.sd),
        0.5 * float((((values - unknowns.mean) / unknowns.sd) ** 2).sum()),
    )
