"""The move to swap: an effect of what was found for its neighbours, from values that follow from its own.

A neighbour is another effect in the place of one (:mod:`invdyn.models.effects.neighbours`), the same one in a softer
form, or at another time. A screen along the data's path cannot see a twin in time or in the direction of gravity,
because they shift the path itself. Of an effect that changes a period it sees what a little does. It does not see that
a large load, made larger, hardly slows a swing any more. Where joints stick, Gauss–Newton may lose its way to an
effect, but not from its neighbour's parameters and path (continuation: Allgower & Georg 1990, "Numerical continuation
methods").
"""

from collections.abc import Container, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from torch import Tensor

from invdyn.diagnosis.hypotheses.attempt import attempt
from invdyn.diagnosis.hypotheses.continuation import lifted
from invdyn.diagnosis.hypotheses.expected_gain import ERRS, needed
from invdyn.diagnosis.hypotheses.innovation_tests import prediction_errors, show_more
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.predict import best_size
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.regime import PASSIVE
from invdyn.diagnosis.problem.unknowns import Unknowns, unknowns
from invdyn.diagnosis.sensitivity.screen import added, screen
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect
from invdyn.models.effects.neighbours import Neighbour, neighbours

ALIKE = 1.0
"""Nats behind a cause from which on its neighbour has not arrived; and that one must gain to be followed again."""

RELATED = ("wider", "narrower")
"""Kinds of neighbours of which one is a special case of the other."""

SOFTER = 3
"""Causes of one effect whose softer forms are refined, and one of two or three: each may take minutes."""

SOFTENED = 0.01
"""Size of the residual, at least, with which a softer form is refined along the ideal one's path."""

SHIFTS = (-1.5, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 1.5)
STRETCHES = (0.4, 0.63, 1.0, 1.6)
SHORT = 0.03
"""Of a burst's duration, or of so many s at least: shifts of its middle, and other durations."""


def follow_neighbours(problem: DiagnosisProblem, found: HypothesisPool, number: int) -> None:
    """Refine the neighbours of causes with so many effects, from values that follow, and theirs, until none is new.

    Twins, special cases and laws that have one come first, of all that are near the best; then softer forms, and what
    the best one may be taken for. What these find has neighbours, too.
    """
    visited: dict[int, FittedHypothesis] = {}
    while fresh := [c for c in _near(found, number, found.top - ERRS) if id(c) not in visited]:
        for cause in fresh:
            visited[id(cause)] = cause
            _swap_each(problem, found, cause, ("twin", "wider", "narrower"))
        for cause in _rough(problem, found, number)[: SOFTER // number]:
            refine_softer(problem, found, cause)
        best = found.ranked[0]
        if len(best.effects) == number:
            _swap_each(problem, found, best, ("alike",))


def _near(found: HypothesisPool, number: int, least: float) -> list[FittedHypothesis]:
    """Causes of so many effects with more than the ``least`` log evidence."""
    return [c for c in found.pool.values() if len(c.effects) == number and c.log_evidence > least]


def _rough(problem: DiagnosisProblem, found: HypothesisPool, number: int) -> list[FittedHypothesis]:
    """Causes with softer forms that leave something, a residual or errors of prediction that are alike; best first.

    Where nothing explains the gap yet, all that gain half of what the best one does: an ideal law may be as far off as
    another effect's.
    """
    least, none = found.top - ERRS, found.pool[""].log_evidence
    if not found.explained:
        least = none + needed(found.top - none, True)
    ideal = [c for c in _near(found, number, least) if any(effect.softened() is not None for effect in c.effects)]
    rough = [c for c in ideal if not c.complete or show_more(problem, c, prediction_errors(problem, c))]
    return sorted(rough, key=lambda cause: -cause.log_evidence)


def _swap_each(
    problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, kinds: Container[str]
) -> None:
    """Refine a cause with each of its effects at another time, and with neighbours of some ``kinds`` in its place."""
    spread = dict(zip(cause.names, cause.sd.tolist(), strict=True)) | cause.noise_sd
    passive, taken = problem.regime == PASSIVE, {effect.key for effect in cause.effects}
    for mine in cause.effects:
        if "moment" in mine.located:
            _refine_moved(problem, found, cause, mine)
        values, sd = (_own(problem, mine, known) for known in (cause.values, spread))
        for other in neighbours(mine, values, sd, found.candidates, problem.model.scale, passive):
            if other.kind in kinds and other.effect.key not in taken and not problem.regime.hides(other.effect):
                _follow(problem, found, cause, mine, other)


def _follow(
    problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect, other: Neighbour
) -> None:
    """Refine a neighbour, unless it is where it can be, has nothing to add, or was followed from as good a cause."""
    there = found.pool.get(_in_place(cause, mine, other.effect))
    related = other.kind in RELATED
    if other.kind == "wider":
        done = cause.complete or (there is not None and there.complete)
    else:
        done = there is not None and there.log_evidence > cause.log_evidence - (0.0 if related else ALIKE)
    if other.kind == "alike":
        its, own = (len(effect.parameters(problem.model.scale)) for effect in (other.effect, mine))
        # what leaves nothing gives way to what says it in fewer numbers, at most
        done = done or (cause.complete and its >= own)
    if not done and not _followed(found, cause, mine, other.effect, _softness(mine) if related else ""):
        paths = {"twin": [cause.path, found.path], "alike": [found.path]}.get(other.kind, [cause.path])
        form, starts = _as_soft(problem, cause, mine, other)
        limits = fair_chance(found, found.pool[""]) if other.kind in ("alike", "wider") else {}
        refine_instead(problem, found, cause, mine, form, starts, paths, limits=limits)


def _own(problem: DiagnosisProblem, effect: Effect, known: Mapping[str, float]) -> dict[str, float]:
    """Of what is ``known`` by "<effect key>.<name>" that of one effect, by its parameters' own names."""
    names = {p.name: f"{effect.key}.{p.name}" for p in effect.parameters(problem.model.scale)}
    return {name: known[key] for name, key in names.items() if key in known}


def _softness(effect: Effect) -> str:
    """Which form it is."""
    return " softer" * effect.softness


def _as_soft(
    problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect, other: Neighbour
) -> tuple[Effect, list[dict[str, float]]]:
    """A neighbour and its starts; a special case, and what has it, is as soft as the cause's effect is."""
    form = other.effect
    if other.kind not in RELATED:
        return form, [dict(start) for start in other.starts]
    for _ in range(mine.softness):
        form = form.softened() or form
    own = _own(problem, mine, cause.values)
    wanted = [p.name for p in form.parameters(problem.model.scale)]
    return form, [{name: own[name] for name in wanted if name in own} | dict(start) for start in other.starts]


def refine_softer(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis) -> None:
    """Refine a cause with the softer form of each of its effects that has one; the better one stays.

    And with that one's, where it has one and something is left.
    """
    for mine in cause.effects:
        form, best = mine, cause
        while form.softened() is not None and not _followed(found, best, form, form, f" {form.key}{_softness(form)}"):
            refined = softer(problem, best, form, **fair_chance(found, found.pool[""]))
            if refined is None:
                break
            found.add(refined)
            if refined.complete:
                break
            form, best = next(e for e in refined.effects if e.key == form.key), refined


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


def fair_chance(found: HypothesisPool, base: FittedHypothesis) -> dict[str, float]:
    """Nats that the first two rounds of a refinement must reach, of what is to be better than ``base``."""
    doubtful = base.log_evidence + needed(found.top - base.log_evidence, False)
    return {"enough": found.top - ERRS, "doubtful": doubtful}


def _in_place(cause: FittedHypothesis, mine: Effect, other: Effect) -> str:
    """Key of a cause with another effect in place of one."""
    return key_of((*(e for e in cause.effects if e is not mine), other))


def _followed(found: HypothesisPool, cause: FittedHypothesis, mine: Effect, other: Effect, form: str = "") -> bool:
    """Whether the neighbour, in a ``form`` of it, was refined from as good a cause before; from now on it was."""
    key = _in_place(cause, mine, other) + form
    if found.followed.get(key, -np.inf) > cause.log_evidence - ALIKE:
        return True
    found.followed[key] = cause.log_evidence
    return False


def _refine_moved(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Move a burst in time while that is better.

    Evidence is as narrow a function of its moment as the arm's answer is sharp, and Gauss–Newton ends in the nearest
    of its peaks. Along the path that it has found, each of a few moments and durations about its own is one regression.
    """
    while not _followed(found, cause, mine, mine, " moved"):
        own = _own(problem, mine, cause.values)
        (first, last), width = problem.model.time[[0, -1]].tolist(), max(own["duration"], SHORT)
        middles = [(own["moment"] + a * width, s * width / 2) for a, s in product(SHIFTS, STRETCHES)]
        times = [(middle - half, middle + half) for middle, half in middles if first < middle < last]
        common, point, model = bared(problem, cause, mine)
        (likely,) = added(screen(problem, model, lifted(model, cause.path), [mine], common, point, times=times))
        refine_instead(problem, found, cause, mine, mine, [likely.values], [cause.path], float(likely.size))
        cause = found.pool[cause.key]
        mine = next(effect for effect in cause.effects if effect.key == mine.key)


def refine_instead(
    problem: DiagnosisProblem,
    found: HypothesisPool,
    cause: FittedHypothesis,
    mine: Effect,
    other: Effect,
    starts: Sequence[Mapping[str, float]],
    paths: Sequence[Tensor],
    size: float | None = None,
    limits: Mapping[str, float] | None = None,
) -> None:
    """Refine a cause with another effect in place of one, from one start after the other, until one leaves nothing.

    Under a residual of its own best ``size``, unless another is given; given up at :func:`.refine`'s ``limits``.
    """
    effects = (*(e for e in cause.effects if e is not mine), other)
    kept = {name: value for name, value in cause.values.items() if not name.startswith(f"{mine.key}.")}
    size = best_size(problem, cause) if size is None else size
    for path, start in product(paths, starts):
        values = kept | {f"{other.key}.{name}": value for name, value in start.items()}
        refined = attempt(refine, problem, effects, values, path, size, **cause.searched, **(limits or {}))
        found.add(refined)
        if refined is not None and refined.complete:
            break


def bared(problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect) -> tuple[Unknowns, np.ndarray, ArmModel]:
    """What a cause is without one of its effects, nothing refined: unknowns, their values (p,) and model."""
    rest = tuple(effect for effect in cause.effects if effect is not mine)
    common, model, known = unknowns(problem, rest), problem.model, cause.values
    if not rest:
        return common, common.mean, model  # as it is stated: without a cause its numbers stood in for one
    model = model.with_effects(*rest)
    model = model.replace(**{n: v for n, v in cause.model.parameters.items() if n in model.parameters})
    return common, np.array([known[name] for name in common.names]), model
