"""The move to exchange: any effect in the place of one of a set's, along the path that the set has found.

Forward selection fails where effects are similar or imitate others together; sequential replacement repairs it
(Miller 2002, "Subset selection in regression", ch. 3). Neighbours (:mod:`.swap`) are what an effect declares; here all
others are tried.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn.diagnosis.hypotheses.add import free_beside, refine_best
from invdyn.diagnosis.hypotheses.continuation import lifted
from invdyn.diagnosis.hypotheses.expected_gain import needed
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.swap import follow_neighbours
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import expanded_about
from invdyn.diagnosis.sensitivity.screen import screen_in_halves
from invdyn.models.effects.base import Effect


def exchange(problem: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> None:
    """Look for a better effect in place of each of the best set's, along the path that it has found.

    Where Gauss–Newton fails, one of several similar effects may be the only one to converge; and of effects
    that imitate others together, none gives way while the rest stay. Where one leaves nothing, those that would leave
    as little have arrived.
    """
    for old in best.effects:
        base = best.less(problem, old)
        if is_searched(old) or base.model.jumping is not None:
            continue  # backlash leaves no path that a screen could be along
        free = free_beside(found, base.effects, old)
        if best.complete and not base.effects:
            arrived = {cause.key for cause in found.pool.values() if cause.complete}
            free = [effect for effect in _likely(found, free) if effect.key not in arrived]
        if not free:
            continue
        model, common, point = expanded_about(problem, base)
        path = lifted(model, best.path)
        screened = screen_in_halves(found.workers, problem, model, path, free, common, point, best.complete)
        nothing = next(s.log_evidence for s in screened if s.effect is None)
        # What is large moves what is seen on no straight line: half of the gain makes a rival, too.
        least = nothing + needed(found.top - nothing, explained=True, rules=problem.rules)
        near = [s for s in screened if s.effect is None or s.log_evidence > least]
        refine_best(
            problem,
            found,
            replace(base, model=model, path=path, log_evidence=nothing),
            near,
            problem.rules.search.max_candidates_exchanged,
        )
    follow_neighbours(problem, found, len(best.effects))


def _likely(found: HypothesisPool, effects: Sequence[Effect]) -> list[Effect]:
    """Effects that, where nothing else was in, gained a share of what the best one did; all, if that is unknown."""
    gained = {s.effect and s.effect.key: s.log_evidence for s in found.first}
    if not gained:
        return list(effects)
    least = gained[None] + found.rules.search.min_exchange_share * (max(gained.values()) - gained[None])
    return [effect for effect in effects if gained.get(effect.key, np.inf) >= least]
