"""The search for causes: the best one's moves to its neighbours, until it has none that is better.

Stepwise search over sets of at most four effects, or as many as are wanted (Hastie, Tibshirani & Friedman 2009,
§3.3; Miller 2002), each set scored by its tempered evidence and its prior (:mod:`.prior`). It begins with "no effect",
and, if there are outliers, with a tracker's mistakes that explain them. Then the best cause makes the
first of these moves that it has not made, which may make another one the best:

    drop    each effect of a set, from the set's path and values (:func:`drop`)
    add     an effect, also to the best single one that a set has overtaken: all that may join are screened, the most
            promising refined (:mod:`.add`)
    swap    an effect of what an addition found for its neighbours, exact twins, special cases, regularised forms,
            others that look like it, from values that its own say (:mod:`.swap`); last, each effect of the best cause
            for any other, along its path (:func:`exchange`)

Where a regression of a robot's log states effects at every joint, the search begins with all that are usual there
(:mod:`.regression_start`). It extends what is best, and drops what is usual and gains nothing, at all places together.

With unknown torque the search is for one effect that only the camera shows. A torque can imitate all others, and only
its prior could speak against them. No limb obeys that prior, so an effect of the observation must gain more evidence
than those others gain from it.

When the budget (:mod:`..budget`) ends the search, the pool is the result.

Everything that was refined stays in the pool, so that rivals which the data cannot tell apart stand side by side. A set
that is less probable than a part of it is no rival of that part (Madigan & Raftery 1994, "Occam's window").
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from torch import Tensor

from invdyn.diagnosis.budget import Spent, attempt
from invdyn.diagnosis.hypotheses.add import add, joinable, refine_best, screened_with
from invdyn.diagnosis.hypotheses.continuation import continued, lifted
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered, needed, others
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.regression_start import Start
from invdyn.diagnosis.hypotheses.swap import follow_neighbours, refine_regularised, without
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, cannot_follow
from invdyn.diagnosis.problem.noise import is_outlier, is_searched
from invdyn.diagnosis.problem.unknowns import expanded_about
from invdyn.diagnosis.sensitivity.screen import screen_in_halves
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect

NOTHING = Start()
Move = Callable[[HypothesisPool, FittedHypothesis], None]
"""Refines neighbours of a base, into the pool."""


def search(
    problem: DiagnosisProblem,
    path: Tensor,
    has_outliers: bool,
    left_out: Sequence[str] = (),
    workers: int = 1,
    start: Start = NOTHING,
) -> HypothesisPool:
    """Search the catalogue for causes, but for effects whose names are ``left_out``, from what :func:`data_path` says.

    And from the ``start`` that a regression gives.

    Raises InputError where the simulation diverges from the recording with any added torque.
    """
    found = _initial_pool(problem, path, has_outliers, considered(problem, left_out), workers)
    problem.budget.share = problem.rules.search.search_share
    with suppress(Spent):
        _begin(found, start)
        climb_moves(found)
    found.missed = len(problem.budget.missed - found.pool.keys())
    return found


def _begin(found: HypothesisPool, start: Start) -> None:
    """Refine what is usual, along the data's path."""
    known = {effect.key for effect in found.candidates}
    problem = found.problem
    for more in dict.fromkeys([(), start.others]):
        effects = [effect for effect in (*start.effects, *more) if effect.key in known]
        keys = tuple(f"{effect.key}." for effect in effects)
        values = {name: value for name, value in start.values.items() if name.startswith(keys)}
        if not effects:
            return
        first = attempt(refine, problem, effects, values, found.path, problem.regime.path_size)
        if first is not None and first.plausible and first.log_evidence > found.pool[""].log_evidence:
            found.everywhere = start.everywhere
            found.add(first)
            problem.budget.share = problem.rules.search.started_share


def climb_moves(found: HypothesisPool) -> None:
    """Make the best cause's next move until it has none left; raises :class:`.Spent` where the budget ends before."""
    if found.problem.regime.knows_torque and found.has_outliers:
        refine_tracker_errors(found)
    made: set[tuple[Move, str]] = set()
    while step := next((s for s in moves_of(found, made) if (s[0], s[1].key) not in made), None):
        move, base = step
        made.add((move, base.key))
        move(found, base)


def moves_of(found: HypothesisPool, made: Collection[tuple[Move, str]]) -> Iterator[tuple[Move, FittedHypothesis]]:
    """Moves of the best cause, in their order, and what of them was ``made`` of others; none is made twice of one.

    Several may imitate two of any sizes, and then hide them: what else is at work shows with the best single effect. To
    what came in the place of another, and leaves nothing, nothing is added.
    """
    best, exchanged = found.best, any(move is exchange for move, _ in made)
    if not found.problem.regime.knows_torque:
        if not best.effects:
            yield add, best
        return
    if found.everywhere:
        if not (found.first and best.complete):
            yield extend, best
        yield thin, best
        return
    single = max((c for c in found.pool.values() if len(others(c)) == 1), key=found.score, default=None)
    if len(best.effects) > 1:
        yield drop, best
    if single is not None and len(others(best)) > 1:
        enough = best.complete and len(others(best)) == 2
        if not enough or others(single)[0].key not in {effect.key for effect in best.effects}:
            yield add, single
    if found.count(best) < found.rules.search.max_effects and not (best.complete and exchanged):
        yield add, best
    if best.effects:
        yield exchange, best


def _initial_pool(
    problem: DiagnosisProblem, path: Tensor, has_outliers: bool, candidates: list[Effect], workers: int
) -> HypothesisPool:
    """A pool of "no effect", along the data's path and, where torques are known, along the simulation's own."""

    def along_its_own() -> tuple[Tensor, FittedHypothesis | None]:
        usual = problem.observing(problem.usual) if has_outliers else problem
        own = continued(usual, problem.model, path, problem.min_size)
        return own, attempt(refine, problem, (), {}, own, problem.min_size)

    starts: list[Callable[[], Any]] = [partial(attempt, refine, problem, (), {}, path, problem.regime.path_size)]
    if problem.regime.knows_torque:
        starts.append(partial(attempt, along_its_own))
    none, *rest = side_by_side(starts, workers, problem.budget)
    if none is None or None in rest:
        raise cannot_follow(problem)
    found = HypothesisPool(problem, candidates, {none.key: none}, [], path, has_outliers, workers=workers)
    for found.simulation_path, alone in rest:
        found.add(alone)
    return found


def refine_tracker_errors(found: HypothesisPool) -> None:
    """Refine each tracker error by itself, along the path that does not follow outliers and the simulation's own.

    Other effects are then added to it, as little else shows before. One by itself that leaves nothing where outliers do
    replaces it, if it is among the most promising: a link that bends far is an outlier for the simulation, too, and
    hides among outliers.
    """
    problem = found.problem
    none = found.pool[""]
    for path in (path for path in (found.simulation_path, found.path) if path is not None):
        for effect in filter(is_outlier, found.candidates):
            base = replace(none, path=path)
            found.add(attempt(refine_searched, problem, base, effect))
        if found.best.complete:
            return
    if not found.best.effects:
        return
    screened = screened_with(found, none)
    tried = replace(found, pool=dict(found.pool))
    refine_best(tried, none, screened, problem.rules.search.max_candidates_for_outliers)
    if tried.explained:
        found.pool, found.first = tried.pool, screened


def extend(found: HypothesisPool, base: FittedHypothesis) -> None:
    """Refine the few most promising effects with what is usual; none is swapped for its neighbours."""
    screened = screened_with(found, base)
    found.first = found.first or screened
    refine_best(found, base, screened, found.rules.search.max_candidates_exchanged)


def thin(found: HypothesisPool, best: FittedHypothesis) -> None:
    """Leave out each effect that is usual, at all its places."""
    for name in sorted(found.everywhere & {effect.name for effect in best.effects}):
        rest = [effect for effect in best.effects if effect.name != name]
        keys = tuple(f"{effect.key}." for effect in rest)
        values = {key: value for key, value in best.values.items() if key.startswith(keys)}
        found.add(attempt(refine, found.problem, rest, values, best.path, found.problem.min_size, **best.searched))


def drop(found: HypothesisPool, best: FittedHypothesis) -> None:
    """Leave out each effect of the best set; what accompanied an ideal law may replace the regularised form of it."""
    problem = found.problem
    for effect in best.effects:
        found.add(attempt(without, problem, best, effect, problem.min_size))
        rest = key_of([other for other in best.effects if other is not effect])
        if rest in found.pool:
            refine_regularised(found, found.pool[rest])


def exchange(found: HypothesisPool, best: FittedHypothesis) -> None:
    """Look for a better effect in place of each of the best set's, along the path that it has found.

    Where Gauss–Newton fails, one of several similar effects may be the only one to converge; and of effects
    that imitate others together, none gives way while the rest stay. Where one leaves nothing, those that would leave
    as little have arrived.
    """
    problem = found.problem
    for old in best.effects:
        base = best.less(problem, old)
        if is_searched(old) or base.model.contact_states is not None:
            continue  # backlash leaves no path that a screen could be along
        free = joinable(found, base.effects, old)
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
        along = replace(base, model=model, path=path, log_evidence=nothing)
        refine_best(found, along, near, problem.rules.search.max_candidates_exchanged)
    follow_neighbours(found, len(best.effects))


def _likely(found: HypothesisPool, effects: Sequence[Effect]) -> list[Effect]:
    """Effects that, where nothing else was in, gained a share of what the best one did; all, if that is unknown."""
    gained = {s.effect and s.effect.key: s.log_evidence for s in found.first}
    if not gained:
        return list(effects)
    least = gained[None] + found.rules.search.min_exchange_share * (max(gained.values()) - gained[None])
    return [effect for effect in effects if gained.get(effect.key, np.inf) >= least]
