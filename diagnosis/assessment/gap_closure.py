"""How far the gap closes on data that the cause's parameters have not seen.

The data are another recording of the same arm where there is one. Else they are the last third of this one, and the
cause is refitted on the first two. Two things keep the parameters that all rows gave them: what was searched
(:mod:`.noise`), and what the first two thirds cannot show, such as a push that comes later. In nats of one-step
prediction, the parameters' posterior integrated over (:mod:`.predict`), with the simulation as it is, with the cause,
and the floor that a simulation without a gap would reach:

    closed = Σ (with − without) / Σ (floor − without)

Of several effects each closes what the others leave: Σ (with all − with all but it) over the same gap. What the data do
not bear out closes nothing, or less.

The interval comes from a bootstrap of the rows in blocks, as neighbouring errors are correlated, and in a circle, so
that the first and last rows count as often as others (Politis & Romano 1992).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.assessment.transfer import carried, leaves_there
from invdyn.diagnosis.budget import Spent, attempt
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, others
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import without
from invdyn.diagnosis.prediction.predict import Scores, scores
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.base import Effect


@dataclass(frozen=True)
class Closed:
    """Result: ``share`` and its central 90 % interval (None where there was no gap to close), and nats per frame."""

    share: float | None
    interval: tuple[float, float] | None
    per_frame: dict[str, float]


def split(problem: DiagnosisProblem) -> tuple[DiagnosisProblem, np.ndarray]:
    """The problem before its last rows, and which rows (T,) those are."""
    seen = np.flatnonzero((~torch.isnan(problem.observations)).any(-1).numpy())
    first = int(seen[int(problem.rules.outcome.fit_share * len(seen))])
    return problem.until(first), np.arange(len(problem.observations)) >= first


@dataclass(frozen=True)
class Unseen:
    """No effect and a cause, as other rows know them, along the paths of those (T,) ``rows`` of ``problem`` that count.

    Attributes:
        leaves: whether the cause leaves something beyond chance on another recording (:mod:`.transfer`).
        fresh: whether its parameters do not know these rows; what earlier ones do not show is as all of them give it.
    """

    problem: DiagnosisProblem
    none: FittedHypothesis
    cause: FittedHypothesis
    rows: np.ndarray
    leaves: bool = False
    fresh: bool = True

    @property
    def scores(self) -> tuple[Scores, Scores]:
        """Scores without and with the cause."""
        none, cause = (scores(self.problem, each, self.rows) for each in (self.none, self.cause))
        return none, cause


def unseen(
    problem: DiagnosisProblem, none: FittedHypothesis, cause: FittedHypothesis, other: DiagnosisProblem | None = None
) -> Unseen:
    """No effect and a cause that were found in ``problem`` on what they have not seen."""
    there, rows, taken = _apart(problem, other)
    none, cause = taken(none), taken(cause)
    leaves = other is not None and leaves_there(other, none, cause)
    fresh = other is not None or not cause.effects or bool(cause.covariance.any())
    return Unseen(there, none, cause, rows, leaves, fresh)


def by_effect(
    problem: DiagnosisProblem,
    found: HypothesisPool,
    cause: FittedHypothesis,
    there: Unseen,
    other: DiagnosisProblem | None,
    seed: int,
) -> dict[str, Closed]:
    """What each effect of ``cause`` closes that the others leave, by the effect's key.

    The others' parameters are those of the set without it, fitted to what the cause was fitted to. An effect without
    which nothing can be followed is left out.
    """
    _, rows, taken = _apart(problem, other)
    time, (nothing, everything) = there.problem.model.time.numpy(), there.scores

    def alone(effect: Effect) -> Closed | None:
        rest = tuple(e for e in cause.effects if e is not effect)
        lesser = found.pool.get(key_of(rest)) or attempt(without, problem, cause, effect, problem.min_size)
        lesser = lesser and attempt(taken, lesser)
        scored = None if lesser is None else attempt(scores, there.problem, lesser, rows)
        return None if scored is None else closed(nothing, everything, rows, time, seed, scored, problem.rules)

    shares = side_by_side([partial(alone, effect) for effect in cause.effects], found.workers, problem.budget)
    return {key(effect): share for effect, share in zip(cause.effects, shares, strict=True) if share is not None}


def all_confirmed(cause: FittedHypothesis, parts: Mapping[str, Closed], rules: Rules = DEFAULT) -> bool:
    """Whether withheld rows confirm each effect of a cause of `min_effects_tested`, outliers not counted.

    Several together imitate what the catalogue lacks, and what does that closes nothing where the arm moves on. The
    90 % interval of what each closes, by its key in ``parts``, must not reach down to nothing; where it was not
    measured there is nothing to say.
    """
    tested = [parts.get(key(effect)) for effect in others(cause)]
    measured = [part.interval for part in tested if part is not None and part.interval is not None]
    return len(tested) < rules.outcome.min_effects_tested or all(low > 0 for low, _ in measured)


def _apart(
    problem: DiagnosisProblem, other: DiagnosisProblem | None
) -> tuple[DiagnosisProblem, np.ndarray, Callable[[FittedHypothesis], FittedHypothesis]]:
    """Where a cause is tried on what it has not seen: the problem, which of its rows count, and the cause there."""
    if other is not None:
        start, _ = data_path(other)
        return other, np.ones(len(other.observations), bool), lambda cause: carried(problem, cause, other, start)
    train, rows = split(problem)
    return problem, rows, lambda cause: fitted_before(problem, cause, train)


def fitted_before(problem: DiagnosisProblem, cause: FittedHypothesis, train: DiagnosisProblem) -> FittedHypothesis:
    """``cause`` with the parameters that the first rows give it, along the path that all rows have.

    Where the first rows do not know it, it keeps the parameters that all rows give it, and these are not learned again.
    """
    settled = replace(cause, covariance=np.zeros_like(cause.covariance))
    try:
        start, size = cause.path[: len(train.observations)], best_size(problem, cause)
        with diverging():
            fitted = refine(train, cause.effects, cause.values, start, size, rounds=2, **cause.searched)
    except (Diverged, Spent):
        return settled  # the first rows by themselves lead nowhere
    # Linearised along a path that knows the withheld rows; the predictions themselves do not.
    return settled if _shown_later(cause, fitted, problem.rules) else replace(fitted, path=cause.path)


def _shown_later(cause: FittedHypothesis, fitted: FittedHypothesis, rules: Rules) -> bool:
    """Whether the rows that a cause is ``fitted`` on say next to nothing of some parameter of its effects."""
    mine = np.array([not name.startswith("body.") for name in cause.names], dtype=bool)
    return bool((fitted.sd[mine] > rules.outcome.max_sd_growth * cause.sd[mine]).any())


def closed(
    nothing: Scores,
    with_cause: Scores,
    rows: np.ndarray,
    time: np.ndarray,
    seed: int,
    besides: Scores | None = None,
    rules: Rules = DEFAULT,
) -> Closed:
    """Share of the gap that is closed on ``rows`` (T,): from ``nothing`` on, or from what is known ``besides``."""
    base = besides or nothing
    use = rows & np.isfinite(nothing.score) & np.isfinite(with_cause.score) & np.isfinite(base.score)
    gain, gap = (with_cause.score - base.score)[use], (with_cause.floor - nothing.score)[use]
    per_frame = {
        "nominal": float(nothing.score[use].mean()),
        "corrected": float(with_cause.score[use].mean()),
        "noise_floor": float(with_cause.floor[use].mean()),
    }
    if gap.sum() <= 0:
        return Closed(None, None, per_frame)
    count = len(gain)
    longest = rules.outcome.bootstrap_block / np.median(np.diff(time[use])) if count > 1 else 1
    length = max(1, min(round(longest), count // 2))
    starts = np.random.default_rng(seed).integers(count, size=(rules.outcome.num_bootstraps, -(-count // length)))
    circle = np.array([np.concatenate([[0.0], each, each[:length]]) for each in (gap, gain)]).cumsum(1)
    total, gained = (circle[:, starts + length] - circle[:, starts]).sum(-1)
    shares = gained[total > 0] / total[total > 0]
    low, high = np.quantile(np.minimum(shares, 1.0), [0.05, 0.95]) if len(shares) else (np.nan, np.nan)
    return Closed(float(min(gain.sum() / gap.sum(), 1.0)), (float(low), float(high)), per_frame)
