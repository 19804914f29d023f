"""Several effects at once: a beam search over sets on one Gram matrix.

Adding one effect after the other goes astray where two or three are at work: the first one chosen is the one that
imitates them all a little. The screen has every effect's columns at its best grid point; whitened side by side, they
give the linearised evidence of any set of effects by a small regression (:mod:`.evidence`). A beam search (Lowerre
1976) keeps the ``BEAM`` most probable sets of each number and extends each by every effect.

A column that an effect adds as it is (at a grid point) is a parameter that is known to be one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.prior import MOST_EFFECTS, coarsened, log_prior_of, tempered
from invdyn.diagnosis.problem.unknowns import Unknowns
from invdyn.diagnosis.sensitivity.evidence import learned, regression
from invdyn.diagnosis.sensitivity.screen import Added, Screened, added, beside
from invdyn.diagnosis.sensitivity.sensitivities import Columns, slopes
from invdyn.diagnosis.sensitivity.whiten import filter_of, whiten
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import HiddenHinge

BEAM = 12
"""Sets of each number of effects that are extended."""
BEST = 40
"""Effects that sets are made of: the best by themselves."""
KNOWN = 1e-4
"""Standard deviation of a factor that is known to be one."""


@dataclass(frozen=True)
class Together:
    """A set of effects, and where its parameters are about; ``score`` is its log posterior but for a constant."""

    effects: tuple[Effect, ...]
    values: dict[str, float]
    size: float
    score: float


@dataclass(frozen=True)
class _Part:
    """An effect's columns among all: numbers, and the Gaussian prior of their factors."""

    screened: Added
    index: tuple[int, ...]
    mean: tuple[float, ...]
    sd: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]


def together(
    problem: DiagnosisProblem,
    model: ArmModel,
    path: Tensor,
    screened: Sequence[Screened],
    common: Unknowns,
    candidates: Sequence[Effect],
    count: int,
) -> list[list[Together]]:
    """The ``count`` most probable pairs by the linearised evidence, then sets of three, and so on; each best first.

    Args:
        screened: by themselves, best first, along ``path`` under ``model``.
        common: unknowns that stay free in all sets, at their prior means in ``model``.
        candidates: all effects considered, for the prior.
    """
    single = added(screened)[:BEST]
    if len(single) < 2:
        return []
    temper = tempered(single[0].log_evidence - next(s.log_evidence for s in screened if s.effect is None))
    parts: list[_Part] = []
    pieces: list[Columns] = []
    start = 1
    for each in single:
        h = each.best
        offset = h.offset is not None
        parts.append(
            _Part(
                each,
                tuple(range(start, start + each.columns.g.shape[-1])),
                (1.0,) * offset + h.mean,
                (KNOWN,) * offset + h.sd,
                (-np.inf,) * offset + h.lower,
                (np.inf,) * offset + h.upper,
            )
        )
        pieces.append(each.columns)
        start += each.columns.g.shape[-1]
    levels = problem.regime.sizes
    rest = slopes(model, common, common.mean, 0.05 * common.sd, path)
    whitened = whiten(problem, filter_of(problem, model, path, levels), beside([*pieces, rest]))
    shared = start + np.arange(len(common.names))

    def evaluate(sets: Sequence[tuple[int, ...]]) -> list[Together]:
        width = max(sum(len(parts[i].index) for i in s) for s in sets) + len(shared)
        index, mean = np.zeros((len(sets), width), int), np.zeros((len(sets), width))
        sd = np.ones((len(sets), width))
        lower, upper = np.full((len(sets), width), -np.inf), np.full((len(sets), width), np.inf)
        for row, members in enumerate(sets):
            at = 0
            for i in members:
                here = slice(at, at + len(parts[i].index))
                index[row, here], mean[row, here] = parts[i].index, parts[i].mean
                sd[row, here], lower[row, here], upper[row, here] = parts[i].sd, parts[i].lower, parts[i].upper
                at = here.stop
            here = slice(at, at + len(shared))
            index[row, here], sd[row, here] = shared, common.sd
        none = np.zeros(len(sets), int)
        results = [
            regression(gram, index, none, mean, sd, lower, upper, whitened.count, log_det)
            for gram, log_det in zip(whitened.gram, whitened.log_det, strict=True)
        ]
        table = np.stack([r.log_evidence for r in results]) + problem.regime.log_prior[:, None]
        evaluated = []
        for row, members in enumerate(sets):
            effects = tuple(parts[i].screened.effect for i in members)
            best = int(table[:, row].argmax())
            factors = results[best].mean[row]
            # At the edge of a half-normal prior an effect is absent; beyond other bounds it is implausible.
            beyond = (factors > upper[row]) | ((factors < lower[row]) & (lower[row] < mean[row]))
            known = learned(results[best].covariance[row], sd[row])
            off = 0.5 * float((((factors - mean[row]) / sd[row]) ** 2).sum())
            score = coarsened(float(logsumexp(table[:, row])), known, off, temper) + log_prior_of(effects, candidates)
            score = -np.inf if beyond.any() else score
            values = _values([parts[i] for i in members], factors)
            evaluated.append(Together(effects, values, float(levels[best]), score))
        return evaluated

    beam: list[tuple[int, ...]] = [(i,) for i in range(len(parts))]
    alone = {members: found.score for members, found in zip(beam, evaluate(beam), strict=True)}
    kept: list[list[Together]] = []
    top = max(alone.values())
    for _ in range(2, MOST_EFFECTS + 1):
        grown = {
            tuple(sorted((*members, i)))
            for members in beam[:BEAM]
            for i in range(len(parts))
            if i not in members and _agree(parts, (*members, i))
        }
        if not grown:
            break
        sets = sorted(grown)
        found = evaluate(sets)
        order = sorted(range(len(sets)), key=lambda row: -found[row].score)
        beam = [sets[row] for row in order]
        # A larger set must beat all smaller ones.
        better = [found[row] for row in order if found[row].score > top]
        if not better:
            break
        kept.append(better[:count])
        top = better[0].score
    return kept


def _agree(parts: Sequence[_Part], members: Sequence[int]) -> bool:
    """Whether a model can have them: one hidden hinge at most."""
    return sum(isinstance(parts[i].screened.effect, HiddenHinge) for i in members) < 2


def _values(members: Sequence[_Part], factors: np.ndarray) -> dict[str, float]:
    values: dict[str, float] = {}
    at = 0
    for part in members:
        h, offset = part.screened.best, part.screened.best.offset is not None
        own = factors[at + offset : at + len(part.index)]
        point = dict(h.point)
        for name, change, low, high in zip(h.free, own, h.lower, h.upper, strict=True):
            point[name] = h.point[name] + np.clip(change, low, high)
        values |= {f"{part.screened.effect.key}.{name}": float(value) for name, value in point.items()}
        at += len(part.index)
    return values
