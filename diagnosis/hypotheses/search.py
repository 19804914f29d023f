"""The search for causes: the best one's moves to its neighbours, until it has none that is better.

Stepwise search over sets of at most four effects, or as many as are wanted (Hastie, Tibshirani & Friedman 2009,
§3.3; Miller 2002), each set scored by its tempered evidence and its prior (:mod:`.prior`). It begins with "no effect",
and, if there are outliers, with a tracker's mistakes that explain them. Then the best cause makes the
first of these moves that it has not made, which may make another one the best:

    drop    each effect of a set, from the set's path and values (:mod:`.drop`)
    add     an effect, also to the best single one that a set has overtaken: all that may join are screened, the most
            promising refined (:mod:`.add`)
    swap    an effect of what an addition found for its neighbours, exact twins, special cases, regularised forms,
            others that look like it, from values that its own say (:mod:`.swap`); last, each effect of the best cause
            for any other, along its path (:mod:`.exchange`)

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

from torch import Tensor

from invdyn.diagnosis.budget import Spent
from invdyn.diagnosis.hypotheses.add import add, refine_best, screened_with
from invdyn.diagnosis.hypotheses.attempt import attempt
from invdyn.diagnosis.hypotheses.continuation import continued
from invdyn.diagnosis.hypotheses.drop import drop
from invdyn.diagnosis.hypotheses.exchange import exchange
from invdyn.diagnosis.hypotheses.pool import MISTAKES, HypothesisPool, considered, others
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, cannot_follow
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect

Move = Callable[[DiagnosisProblem, HypothesisPool, FittedHypothesis], None]
"""Refines neighbours of a base, into the pool."""


def search(
    problem: DiagnosisProblem,
    path: Tensor,
    has_outliers: bool,
    left_out: Sequence[str] = (),
    workers: int = 1,
) -> HypothesisPool:
    """Search the catalogue for causes, but for effects whose names are ``left_out``, from what :func:`data_path` says.

    Raises InputError where the simulation diverges from the recording with any added torque.
    """
    found = _initial_pool(problem, path, has_outliers, considered(problem, left_out), workers)
    problem.budget.share = problem.rules.search.search_share
    with suppress(Spent):
        _run(problem, found)
    found.missed = len(problem.budget.missed - found.pool.keys())
    return found


def _run(problem: DiagnosisProblem, found: HypothesisPool) -> None:
    """Make the best cause's next move until it has none left; raises :class:`.Spent` where the budget ends before."""
    known = problem.regime.knows_torque
    if known and found.has_outliers:
        _refine_tracker_errors(problem, found)
    made: set[tuple[Move, str]] = set()
    while step := next((s for s in _moves(found, known, made) if (s[0], s[1].key) not in made), None):
        move, base = step
        made.add((move, base.key))
        move(problem, found, base)


def _moves(
    found: HypothesisPool, known: bool, made: Collection[tuple[Move, str]]
) -> Iterator[tuple[Move, FittedHypothesis]]:
    """Moves of the best cause, in their order, and what of them was ``made`` of others; none is made twice of one.

    Several may imitate two of any sizes, and then hide them: what else is at work shows with the best single effect. To
    what came in the place of another, and leaves nothing, nothing is added.
    """
    best = found.best
    if not known:
        if not best.effects:
            yield add, best
        return
    single = max((c for c in found.pool.values() if len(others(c)) == 1), key=found.score, default=None)
    if len(best.effects) > 1:
        yield drop, best
    if single is not None and len(others(best)) > 1:
        enough = best.complete and len(others(best)) == 2
        if not enough or others(single)[0].key not in {effect.key for effect in best.effects}:
            yield add, single
    if len(best.effects) < found.rules.search.max_effects and not (
        best.complete and any(move is exchange for move, _ in made)
    ):
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
    found = HypothesisPool(candidates, {none.key: none}, [], path, has_outliers, workers=workers, rules=problem.rules)
    for found.simulation_path, alone in rest:
        found.add(alone)
    return found


def _refine_tracker_errors(problem: DiagnosisProblem, found: HypothesisPool) -> None:
    """Refine each tracker error by itself, along the path that does not follow outliers and the simulation's own.

    Other effects are then added to it, as little else shows before. One by itself that leaves nothing where outliers do
    replaces it, if it is among the most promising: a link that bends far is an outlier for the simulation, too, and
    hides among outliers.
    """
    none = found.pool[""]
    for path in (path for path in (found.simulation_path, found.path) if path is not None):
        for effect in (e for e in found.candidates if e.name in MISTAKES):
            base = replace(none, path=path)
            found.add(attempt(refine_searched, problem, base, effect))
        if found.best.complete:
            return
    if not found.best.effects:
        return
    screened = screened_with(problem, found, none)
    tried = replace(found, pool=dict(found.pool))
    refine_best(problem, tried, none, screened, problem.rules.search.max_candidates_for_outliers)
    if tried.explained:
        found.pool, found.first = tried.pool, screened
