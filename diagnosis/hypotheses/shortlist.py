"""Screened effects that are worth refining.

A refinement costs a hundred times what a screen does. An effect is refined if it may raise the posterior by what the
screen says, which errs, and if it gains a fair share of what the best one gains.

An effect that would need values beyond what is plausible is refined in its softer form as well, if it has one: they may
stand for what the ideal form lacks. So is, in :mod:`.moves`, one that leaves something.

With a torque that nobody knows, one must gain more than what that torque could do as well, unless errors of prediction
show that something is left whatever it does.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, TypeVar

import numpy as np

from invdyn.diagnosis.budget import Spent
from invdyn.diagnosis.decision import RULE
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.predict import best_size
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.prior import log_prior_of
from invdyn.diagnosis.problem.regime import imitable
from invdyn.diagnosis.sensitivity.screen import Added, Screened, added
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.base import Effect
from invdyn.models.effects.composition import NotTogether

T = TypeVar("T")

TOO_FAR_BEHIND, SHARE, HALF = 60.0, 0.1, 0.5
"""Candidates beyond the third (the first, where one leaves nothing) are refined where the screen has them within so
many nats of the best, or gain a share of what the best gains (half, where one leaves nothing): of much it errs by
much."""

PAIR = 2
"""Candidates that are refined side by side, before the next ones are measured by them."""

DOUBT, SURE = 5.0, 2.0
"""Nats by which the screen may err, and beside a cause that leaves nothing: less promising ones are not refined."""

SOFTENED = 0.01
"""Size of the residual, at least, with which a softer form is refined along the ideal one's path."""


def refine_promising(
    problem: DiagnosisProblem,
    found: HypothesisPool,
    base: FittedHypothesis,
    screened: Sequence[Screened],
    width: int,
) -> None:
    """Refine those of the screened effects, added to ``base``, that may raise the posterior, ``width`` at most.

    The first one alone: it may leave nothing, and spare the others.
    """
    # An effect must raise the posterior, which its prior lowers; the screen errs by some nats.
    nothing, temper = next(s.log_evidence for s in screened if s.effect is None), found.temper
    bare = log_prior_of(base.effects, found.candidates)
    doubt = SURE if base.effects and base.complete else DOUBT
    promising = [
        s
        for s in added(screened)
        if temper * (s.log_evidence - nothing) + log_prior_of((*base.effects, s.effect), found.candidates)
        > bare - doubt
    ]
    most = screened[0].log_evidence - nothing
    if not problem.regime.knows_torque:
        bar = idle(screened)
        promising = [s for s in promising if s.log_evidence > bar and s.dprime > RULE.faint]
    promising = promising[:width]
    for first, last in ((0, 1), *((i, i + PAIR) for i in range(1, len(promising), PAIR))):
        complete = found.ranked[0].complete
        # Along the path of one that leaves nothing, others get their chance (:func:`.exchange`).
        least = min(most - TOO_FAR_BEHIND, (HALF if complete else SHARE) * most)
        parts = [
            partial(_refined, problem, base, each, fair_chance(found, base))
            for place, each in enumerate(promising[first:last], first)
            if place < (1 if complete else 3) or each.log_evidence - nothing >= least
        ]
        found.add_all(problem, parts)


def fair_chance(found: HypothesisPool, base: FittedHypothesis) -> dict[str, float]:
    """Nats that the first two rounds of a refinement must reach, of what is to be better than ``base``."""
    behind = max(TOO_FAR_BEHIND, (1 - SHARE) * (found.top - base.log_evidence))
    return {"enough": found.top - TOO_FAR_BEHIND, "doubtful": found.top - behind}


def refine_barred(
    problem: DiagnosisProblem, found: HypothesisPool, base: FittedHypothesis, screened: Sequence[Screened]
) -> None:
    """Refine those added to ``base`` that no torque imitates and that gain less in the screen than one that it does.

    For where the best cause's errors of prediction show more, though a torque may do anything: a large effect on what
    is seen bends the path that the screen is along, and what one on the motion gains is the torque's prior's mistake.
    And whatever the screen says, those that have a softer form, in that form: of tissue that swings, an ideal one that
    follows at once may explain nothing.
    """
    nothing, bar = next(s.log_evidence for s in screened if s.effect is None), idle(screened)
    seen = [s for s in added(screened) if not imitable(s.effect) and s.dprime > RULE.faint]
    soft = {s.effect.key for s in seen if s.effect.softened() is not None}
    barred = [s for s in seen if s.effect.key in soft or nothing + DOUBT < s.log_evidence <= bar]

    def refined(each: Added) -> list[FittedHypothesis | None]:
        known = found.pool.get(key_of((*base.effects, each.effect)))
        causes = [known] if known else _refined(problem, base, each, {})
        ideal = [c for c in causes if each.effect.key in soft and not any(effect.softness for effect in c.effects)]
        return [*causes, *(softer(problem, cause, each.effect) for cause in ideal)]

    found.add_all(problem, [partial(refined, each) for each in barred])


def _refined(
    problem: DiagnosisProblem, base: FittedHypothesis, each: Added, limits: dict[str, Any]
) -> list[FittedHypothesis]:
    """``base`` and a screened effect, from the screen's values, and from the next best time where they leave a rest."""
    refined = []
    for start in (each.values, each.elsewhere):
        if start is None:
            break
        values = {f"{each.effect.key}.{name}": value for name, value in start.items()} | base.values
        effects = (*base.effects, each.effect)
        cause = attempt(refine, problem, effects, values, each.path, each.size, **base.searched, **limits)
        if cause is not None and not cause.plausible and cause.log_evidence > limits.get("enough", -np.inf):
            cause = softer(problem, cause, each.effect, **limits) or cause
        if cause is not None:
            refined.append(cause)
            if cause.complete:
                break
    return refined


def softer(problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect, **limits: Any) -> FittedHypothesis | None:
    """A cause with the softer form of one of its effects, from its values and path; None where that has none."""
    form = mine.softened()
    if form is None:
        return None
    effects = (*(e for e in cause.effects if e.key != mine.key), form)
    ideal = {p.name: cause.values[f"{mine.key}.{p.name}"] for p in mine.parameters(problem.model.scale)}
    values = cause.values | {f"{form.key}.{name}": value for name, value in form.as_soft(ideal).items()}
    size = max(best_size(problem, cause), SOFTENED)
    return attempt(refine, problem, effects, values, cause.path, size, **cause.searched, **limits)


def idle(screened: Sequence[Screened]) -> float:
    """The highest evidence of effects that an unknown torque imitates: so many nats its prior gives for nothing."""
    return max(s.log_evidence for s in screened if s.effect is None or imitable(s.effect))


def attempt(work: Callable[..., T], *arguments: Any, **options: Any) -> T | None:
    """Such as a refinement; None where it leads to parameters with which the simulation does not run at all, to
    effects that no simulation has together, or where the budget is spent.
    """
    try:
        with diverging():
            return work(*arguments, **options)
    except (Diverged, NotTogether, Spent):
        return None
