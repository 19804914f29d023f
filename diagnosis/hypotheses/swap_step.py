"""Sets of causes with one effect less, or another in the place of one.

Forward selection goes astray where effects are alike or imitate others together; backward steps and exchanges mend it
(sequential replacement: Miller 2002, "Subset selection in regression", ch. 3).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn.diagnosis.hypotheses.continuation import FIRM, lifted
from invdyn.diagnosis.hypotheses.moves import bared, refine_kin, refine_softer
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import HALF, TOO_FAR_BEHIND, attempt, refine_promising
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.sensitivity.screen import screen_in_halves
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import Follower, Hidden, HiddenHinge

SWAPS, FAIR = 2, 0.3
"""Candidates that are refined when one is to take another's place; what they have to gain by themselves where the best
cause leaves nothing, of what the best effect does."""


def reduce(problem: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> None:
    """Leave each effect of the best set out, from the path and the values that it was found with.

    A set may be what it took to get near the parameters of one of its members; and what stands beside an ideal friction
    or stop may stand for the softer form of that.
    """
    for effect in best.effects:
        found.add(attempt(without, problem, best, effect, FIRM))
        rest = key_of([other for other in best.effects if other is not effect])
        if rest in found.pool:
            refine_softer(problem, found, found.pool[rest])


def without(problem: DiagnosisProblem, whole: FittedHypothesis, effect: Effect, size: float) -> FittedHypothesis | None:
    """A set without one of its effects, from its path and values, under a residual of ``size``; None if it is no gain.

    Several that were searched may have left a part to each other: without one, the others are searched anew.
    """
    rest = tuple(e for e in whole.effects if e is not effect)
    searched = [e for e in rest if is_searched(e)]
    if not searched:
        return refine(problem, rest, whole.values, whole.path, size)
    if not is_searched(effect):
        return refine(problem, rest, whole.values, whole.path, size, **whole.searched)
    cause: FittedHypothesis | None
    cause = refine(problem, tuple(e for e in rest if e not in searched), whole.values, whole.path, size)
    for each in searched:
        cause = cause and refine_searched(problem, cause, each)
    return cause


def exchange(problem: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> None:
    """Look for a better effect in place of each of the best set's, along the path that it has found.

    Where Gauss–Newton goes astray, one of several effects that are alike may be the only one to arrive; and of effects
    that imitate others together, none gives way while the rest stay. Where one leaves nothing, those that would leave
    as little have arrived.
    """
    for old in best.effects:
        rest = tuple(effect for effect in best.effects if effect is not old)
        if is_searched(old) or any(isinstance(effect, HiddenHinge) and effect.forgets for effect in rest):
            continue  # play leaves no path that a screen could be along
        _, common, point, model = bared(problem, best, old)
        free = free_beside(found, rest, old)
        if best.complete and not rest:
            arrived = {cause.key for cause in found.pool.values() if cause.complete}
            free = [effect for effect in _likely(found, free) if effect.key not in arrived]
        if not free:
            continue
        path = lifted(model, best.path)
        screened = screen_in_halves(found.workers, problem, model, path, free, common, point, best.complete)
        nothing = next(s.log_evidence for s in screened if s.effect is None)
        # What is large moves what is seen on no straight line: half of the gain makes a rival, too.
        least = min(found.top - TOO_FAR_BEHIND, nothing + HALF * (found.top - nothing))
        near = [s for s in screened if s.effect is None or s.log_evidence > least]
        by_size = np.r_[-np.inf, best.by_size[1:]]
        without_it = replace(best, effects=rest, model=model, path=path, log_evidence=nothing, by_size=by_size)
        refine_promising(problem, found, without_it, near, SWAPS)
    refine_kin(problem, found, len(best.effects))


def _likely(found: HypothesisPool, effects: Sequence[Effect]) -> list[Effect]:
    """Effects that, where nothing else was in, gained a fair share of what the best one did; all, if nobody knows."""
    gained = {s.effect and s.effect.key: s.log_evidence for s in found.first}
    if not gained:
        return list(effects)
    least = gained[None] + FAIR * (max(gained.values()) - gained[None])
    return [effect for effect in effects if gained.get(effect.key, np.inf) >= least]


def free_beside(found: HypothesisPool, taken: Sequence[Effect], *others: Effect) -> list[Effect]:
    """Effects with columns that may join those that are ``taken``, but for ``others``."""
    keys = {effect.key for effect in (*taken, *others)}
    busy = any(isinstance(effect, Hidden) and not isinstance(effect, Follower) for effect in taken)
    free = [e for e in found.candidates if e.key not in keys and not is_searched(e)]
    return [e for e in free if not (busy and isinstance(e, HiddenHinge))]
