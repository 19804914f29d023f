"""The move to swap: an effect of what was found for its neighbours, from values that follow from its own.

A neighbour is another effect in the place of one (:mod:`..catalogue.neighbours`), the same one in a
regularised form, or at another time. A screen along the data's path cannot see a twin in time or in the direction of
gravity, because they shift the path itself. Of an effect that changes a period it sees what a little does. It does not
see that a large load, made larger, hardly slows a swing any more. Where joints stick, Gauss–Newton may lose its way to
an effect, but not from its neighbour's parameters and path (continuation: Allgower & Georg 1990, "Numerical
continuation methods").
"""

from collections.abc import Container, Mapping
from itertools import product
from typing import Any

import numpy as np
from torch import Tensor

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.catalogue.neighbours import Neighbour, neighbours
from invdyn.diagnosis.hypotheses.continuation import lifted
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, needed
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.innovation_tests import prediction_errors, show_more
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size, key_of, of_effect
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import expanded_about
from invdyn.diagnosis.sensitivity.screen import added, screen
from invdyn.models.effects.base import Effect

RELATED = ("wider", "narrower")
"""Kinds of neighbours of which one is a special case of the other."""


def follow_neighbours(found: HypothesisPool, number: int) -> None:
    """Refine the neighbours of causes with so many effects, from values that follow, and theirs, until none is new.

    Twins, special cases and laws that have one come first, of all that are near the best; then regularised forms, and
    what the best one may be taken for. What these find has neighbours, too.
    """
    problem = found.problem
    visited: dict[int, FittedHypothesis] = {}
    errs = problem.rules.search.large_screen_error
    while fresh := [c for c in _near(found, number, found.top - errs) if id(c) not in visited]:
        for cause in fresh:
            visited[id(cause)] = cause
            swap_each(found, cause, ("twin", "wider", "narrower"))
        for cause in _rough(found, number)[: problem.rules.search.max_variants // number]:
            refine_regularised(found, cause)
        best = found.best
        if len(best.effects) == number:
            swap_each(found, best, ("similar",))


def _near(found: HypothesisPool, number: int, least: float) -> list[FittedHypothesis]:
    """Causes of so many effects with more than the ``least`` log evidence."""
    return [c for c in found.pool.values() if len(c.effects) == number and c.log_evidence > least]


def _rough(found: HypothesisPool, number: int) -> list[FittedHypothesis]:
    """Causes with regularised forms that leave a residual or correlated errors of prediction; best first.

    Where nothing explains the gap yet, all that gain half of what the best one does: an ideal law may be as far off as
    another effect's.
    """
    problem = found.problem
    least, none = found.top - problem.rules.search.large_screen_error, found.pool[""].log_evidence
    if not found.explained:
        least = none + needed(found.top - none, explained=True, rules=problem.rules)
    ideal = [c for c in _near(found, number, least) if any(map(problem.catalogue.nonideal, c.effects))]
    rough = [c for c in ideal if not c.complete or show_more(problem, c, prediction_errors(problem, c))]
    return sorted(rough, key=lambda cause: -cause.log_evidence)


def swap_each(found: HypothesisPool, cause: FittedHypothesis, kinds: Container[str]) -> None:
    """Refine a cause with each of its effects at another time, and with neighbours of some ``kinds`` in its place."""
    problem = found.problem
    passive, taken = problem.regime.name == "passive", {effect.key for effect in cause.effects}
    for mine in cause.effects:
        if any(p.located for p in mine.parameters(problem.model.scale)):
            _refine_moved(found, cause, mine)
        values, sd = of_effect(mine, cause.values), of_effect(mine, cause.sds)
        given = found.candidates, problem.model.scale, passive, problem.catalogue
        for other in neighbours(mine, values, sd, *given):
            if other.kind in kinds and other.effect.key not in taken and not problem.regime.hides(other.effect):
                _follow(found, cause, mine, other)


def _follow(found: HypothesisPool, cause: FittedHypothesis, mine: Effect, other: Neighbour) -> None:
    """Refine a neighbour, unless it is where it can be, has nothing to add, or was followed from as good a cause."""
    problem = found.problem
    there = found.pool.get(_in_place(cause, mine, other.effect))
    related = other.kind in RELATED
    if other.kind == "wider":
        done = cause.complete or (there is not None and there.complete)
    else:
        apart = 0.0 if related else problem.rules.search.equal_gain
        done = there is not None and there.log_evidence > cause.log_evidence - apart
    if other.kind == "similar":
        its, ours = (len(effect.parameters(problem.model.scale)) for effect in (other.effect, mine))
        # what leaves nothing gives way to what says it in fewer numbers, at most
        done = done or (cause.complete and its >= ours)
    if not done and not _followed(found, cause, mine, other.effect, _softness(mine) if related else ""):
        paths = {"twin": [cause.path, found.path], "similar": [found.path]}.get(other.kind, [cause.path])
        form, starts = _as_soft(problem, cause, mine, other)
        limits = early_stop_limits(found, found.pool[""]) if other.kind in ("similar", "wider") else {}
        for path, start in product(paths, starts):
            refined = instead(problem, cause, mine, form, start, path, best_size(problem, cause), **limits)
            found.add(refined)
            if refined is not None and refined.complete:
                break


def _softness(effect: Effect) -> str:
    """Which form it is."""
    return " regularised" * effect.variant


def _as_soft(
    problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect, other: Neighbour
) -> tuple[Effect, list[dict[str, float]]]:
    """A neighbour and its starts; a special case, and what has it, is as soft as the cause's effect is."""
    form = other.effect
    if other.kind not in RELATED:
        return form, [dict(start) for start in other.starts]
    for _ in range(mine.variant):
        form = problem.catalogue.nonideal(form) or form
    wanted = {p.name for p in form.parameters(problem.model.scale)}
    kept = {name: value for name, value in of_effect(mine, cause.values).items() if name in wanted}
    return form, [kept | dict(start) for start in other.starts]


def refine_regularised(found: HypothesisPool, cause: FittedHypothesis) -> None:
    """Refine a cause with the regularised form of each of its effects that has one; the better one stays.

    And with that one's, where it has one and something is left.
    """
    problem = found.problem
    for mine in cause.effects:
        form, best = mine, cause
        while problem.catalogue.nonideal(form) is not None:
            if _followed(found, best, form, form, f" {form.key}{_softness(form)}"):
                break
            refined = regularised(problem, best, form, **early_stop_limits(found, found.pool[""]))
            if refined is None:
                break
            found.add(refined)
            if refined.complete:
                break
            form, best = next(e for e in refined.effects if e.key == form.key), refined


def regularised(
    problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect, **limits: Any
) -> FittedHypothesis | None:
    """A cause with the regularised form of one of its effects, from its values and path; None where that has none."""
    form = problem.catalogue.nonideal(mine)
    if form is None:
        return None
    size = max(best_size(problem, cause), problem.rules.search.min_variant_size)
    start = problem.catalogue.of(form).start(form, of_effect(mine, cause.values))
    return instead(problem, cause, mine, form, start, cause.path, size, **limits)


def early_stop_limits(found: HypothesisPool, base: FittedHypothesis) -> dict[str, float]:
    """Nats that the first two rounds of a refinement must reach, of what is to be better than ``base``."""
    behind = found.top - base.log_evidence
    doubtful = base.log_evidence + needed(behind, explained=False, rules=found.rules)
    return {"enough": found.top - found.rules.search.large_screen_error, "doubtful": doubtful}


def _in_place(cause: FittedHypothesis, mine: Effect, other: Effect) -> str:
    """Key of a cause with another effect in place of one."""
    return key_of((*(e for e in cause.effects if e is not mine), other))


def _followed(found: HypothesisPool, cause: FittedHypothesis, mine: Effect, other: Effect, form: str = "") -> bool:
    """Whether the neighbour, in a ``form`` of it, was refined from as good a cause before; from now on it was."""
    key = _in_place(cause, mine, other) + form
    if found.followed.get(key, -np.inf) > cause.log_evidence - found.rules.search.equal_gain:
        return True
    found.followed[key] = cause.log_evidence
    return False


def _refine_moved(found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Move a burst in time while that is better.

    Evidence is as narrow a function of its moment as the arm's answer is sharp, and Gauss–Newton ends in the nearest
    of its peaks. Along the path that it has found, each of a few moments and durations about its own is one regression.
    """
    problem, rules = found.problem, found.rules.search
    first, last = problem.model.time[[0, -1]].tolist()
    while not _followed(found, cause, mine, mine, " moved"):
        there = of_effect(mine, cause.values)
        width, moves = max(there["duration"], rules.min_burst), product(rules.burst_shifts, rules.burst_factors)
        middles = [(there["moment"] + a * width, s * width / 2) for a, s in moves]
        times = [(middle - half, middle + half) for middle, half in middles if first < middle < last]
        model, common, point = expanded_about(problem, cause.less(problem, mine))
        (likely,) = added(screen(problem, model, lifted(model, cause.path), [mine], common, point, times=times))
        found.add(instead(problem, cause, mine, mine, likely.values, cause.path, likely.size))
        cause = found.pool[cause.key]
        mine = next(effect for effect in cause.effects if effect.key == mine.key)


def instead(
    problem: DiagnosisProblem,
    cause: FittedHypothesis,
    mine: Effect,
    other: Effect,
    start: Mapping[str, float],
    path: Tensor,
    size: float,
    **limits: Any,
) -> FittedHypothesis | None:
    """A cause with another effect, or another form of it, in place of one, refined under a residual of ``size``.

    From a ``start`` of its parameters, by their own names, and the values that the cause has of the others.
    """
    effects = (*(effect for effect in cause.effects if effect.key != mine.key), other)
    values = cause.values | {f"{other.key}.{name}": value for name, value in start.items()}
    return attempt(refine, problem, effects, values, path, size, **cause.searched, **limits)


def without(problem: DiagnosisProblem, whole: FittedHypothesis, effect: Effect, size: float) -> FittedHypothesis | None:
    """A set without one of its effects, from its path and values, under a residual of ``size``.

    Several that were searched may have left a part to each other: without one, the others are searched again, and None
    comes of what gains nothing then.
    """
    rest = tuple(e for e in whole.effects if e is not effect)
    searched = [e for e in rest if is_searched(e)]
    if not (searched and is_searched(effect)):
        return refine(problem, rest, whole.values, whole.path, size, **whole.searched)
    cause: FittedHypothesis | None
    cause = refine(problem, tuple(e for e in rest if e not in searched), whole.values, whole.path, size)
    for each in searched:
        cause = cause and refine_searched(problem, cause, each)
    return cause
