"""The search for causes: screen, refine the best, add another effect, measure again.

Forward selection with replacement over sets of at most four effects, or as many as are asked for (Hastie, Tibshirani &
Friedman 2009, §3.3), each set scored by its tempered evidence and its prior (:mod:`.prior`):

    1  Refine "no effect". If detections are stray, refine first the mistakes of a tracker that explain them.
    2  Refine the best single effects of the screen. If the best one leaves something, also try effects that would
       leave little, effects whose size no screen tells (``Effect.scan``, from several values), and the best one in
       shorter sub-steps (:mod:`.substeps`). If that leaves something, or its parameters are not credible
       (:mod:`.credible`), try sets of up to four in a beam (:mod:`.beam_search`).
    3  Given the best set, screen every effect that could be added. Refine the most promising (:mod:`.forward_step`).
    4  When one has become two, drop the older and look for a better one in its place.
    5  Repeat from 3 until no addition raises the posterior. If sets of several have overtaken the best single effect,
       add to that one, too, in search of a pair that leaves nothing.
    6  Leave effects of the best set out, one by one, while that raises the posterior.
    7  Look for a better effect in place of each, along the path of the set. If there is one, or the reduced set has
       not been through 3, repeat from 3.
    8  If the best set leaves something after all, refine every effect of the observation beside the best single one,
       and repeat from 6.

With unknown torque the search is for one effect that only the camera shows. A torque can imitate all others, and only
its prior could speak against them. No limb obeys that prior, so an effect of the observation must gain more evidence
than those others gain from it.

When the budget (:mod:`..budget`) ends the search, the pool is the result.

Everything that was refined stays in the pool, so that rivals which the data cannot tell apart stand side by side. A set
that is less probable than a part of it is no rival of that part (Madigan & Raftery 1994, "Occam's window").
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

from torch import Tensor

from invdyn.diagnosis.budget import SEARCH, Spent
from invdyn.diagnosis.hypotheses.continuation import FIRM, led
from invdyn.diagnosis.hypotheses.credible import credible
from invdyn.diagnosis.hypotheses.forward_step import extend, screened_with
from invdyn.diagnosis.hypotheses.moves import refine_kin
from invdyn.diagnosis.hypotheses.pool import MISTAKES, HypothesisPool, considered, others
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import SHARE, TOO_FAR_BEHIND, attempt, refine_every, refine_promising
from invdyn.diagnosis.hypotheses.substeps import shortened
from invdyn.diagnosis.hypotheses.swap_step import SWAPS, exchange, reduce, without
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, cannot_follow
from invdyn.diagnosis.problem.prior import MOST_EFFECTS
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.beam_search import together
from invdyn.diagnosis.sensitivity.screen import Screened
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect

WIDTH, SETS, INSTEAD = (10, 4, 5, 5), 2, 2
"""Candidates refined when the first, second, … effect is sought, sets of several that are refined as a whole, and
candidates refined instead of stray detections."""

FORWARD = len(WIDTH)
"""Effects that are added one by one, at least, if there may be so many."""


def search(
    problem: DiagnosisProblem,
    path: Tensor,
    stray: bool,
    left_out: Sequence[str] = (),
    workers: int = 1,
    most: int = MOST_EFFECTS,
) -> HypothesisPool:
    """Search the catalogue for causes, but for effects whose names are ``left_out``, from what :func:`data_path` says.

    Of no more than ``most`` effects at once.
    Raises InputError where the simulation runs away from the recording whatever torque is added.
    """
    found = replace(_begun(problem, path, stray, considered(problem, left_out), workers), most=most)
    problem.budget.share = SEARCH
    with suppress(Spent):
        _sought(problem, found)
    found.missed = len(problem.budget.missed - found.pool.keys())
    return found


def _sought(problem: DiagnosisProblem, found: HypothesisPool) -> None:
    """Look for causes until nothing that is tried is better; raises :class:`.Spent` where the budget ends before."""
    known, most = problem.regime != "unknown_torque", found.most
    if known and found.stray:
        _mistaken(problem, found)
    extended: set[str] = set()
    for _ in range(max(FORWARD, most) if known else 1):
        best = found.ranked[0]
        if best.key in extended or len(best.effects) >= most:
            break
        extended.add(best.key)
        screened = extend(problem, found, best, _width(best))
        if known and not best.effects:
            problem = shortened(problem, found)
        if known and not best.effects and not _enough(problem, found.ranked[0]):
            _several(problem, found, screened)
            reduce(problem, found)
            _overtaken(problem, found, extended)
        _without_older(problem, found, best)
    _settled(problem, found, extended)
    singles = _singles(found)
    if known and singles and most > 1 and not found.ranked[0].complete:
        base = max(singles, key=found.score)
        best = found.ranked[0]
        refine_every(problem, found, base, screened_with(problem, found, base, False)[0])
        if found.ranked[0].key != best.key:
            _settled(problem, found, extended)


def _enough(problem: DiagnosisProblem, cause: FittedHypothesis) -> bool:
    """Whether a cause leaves nothing, by effects that are what they are called."""
    return cause.complete and credible(problem, cause)


def _settled(problem: DiagnosisProblem, found: HypothesisPool, extended: set[str]) -> None:
    """Leave effects out and exchange them until the best set stays.

    Where it leaves something others may join what was exchanged, and what is left if it has not been ``extended`` yet:
    a large effect may be reached only by way of several that imitate it, and hide a small one until then.
    """
    reduce(problem, found)
    while problem.regime != "unknown_torque" and found.ranked[0].effects:
        before = found.ranked[0]
        exchange(problem, found)
        best = found.ranked[0]
        grows = not best.complete and len(best.effects) < found.most
        if best.key == before.key and (not grows or best.key in extended):
            break
        if grows:
            extended.add(best.key)
            extend(problem, found, best, SWAPS if best.key != before.key else _width(best))
        reduce(problem, found)
        if found.ranked[0].key == before.key:
            break


def _width(base: FittedHypothesis) -> int:
    """Candidates that are refined beside a base."""
    return WIDTH[min(len(others(base)), FORWARD - 1)]


def _begun(
    problem: DiagnosisProblem, path: Tensor, stray: bool, candidates: list[Effect], workers: int
) -> HypothesisPool:
    """A pool of "no effect", along the data's path and, where torques are known, along the simulation's own."""

    def along_its_own() -> tuple[Tensor, FittedHypothesis | None]:
        usual = problem.observing(problem.usual) if stray else problem
        aside = led(usual, problem.model, path, FIRM)
        return aside, attempt(refine, problem, (), {}, aside, FIRM)

    starts: list[Callable[[], Any]] = [partial(attempt, refine, problem, (), {}, path, problem.loose)]
    if problem.regime != "unknown_torque":
        starts.append(partial(attempt, along_its_own))
    none, *rest = side_by_side(starts, workers, problem.budget)
    if none is None or None in rest:
        raise cannot_follow(problem)
    found = HypothesisPool(candidates, {none.key: none}, [], path, stray, workers=workers)
    for found.aside, alone in rest:
        if alone is not None:
            found.add(alone)
    return found


def _without_older(problem: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> None:
    """Where the ``best`` effect has become two, look for a better one in place of the older."""
    grown = found.ranked[0]
    if len(grown.effects) != 2 or len(best.effects) != 1:
        return
    newer, older = sorted(grown.effects, key=lambda effect: effect.key == best.key)
    base = found.pool.get(newer.key) or attempt(without, problem, grown, older, problem.loose)
    if base is not None:
        found.add(base)
        extend(problem, found, base, SWAPS)


def _overtaken(problem: DiagnosisProblem, found: HypothesisPool, extended: set[str]) -> None:
    """Where several have overtaken the best single effect, extend that one, too, unless it is one of two that suffice.

    Several may imitate two whatever their sizes, and then stand in the way: what else is at work shows beside the one.
    """
    singles, best = _singles(found), found.ranked[0]
    if len(others(best)) < 2 or not singles:
        return
    base = max(singles, key=found.score)
    if best.complete and len(others(best)) == 2 and others(base)[0].key in {effect.key for effect in best.effects}:
        return
    if base.key not in extended:
        extended.add(base.key)
        extend(problem, found, base, WIDTH[1])


def _mistaken(problem: DiagnosisProblem, found: HypothesisPool) -> None:
    """Refine what leaves stray detections by itself, along the path that does not follow them and the simulation's own.

    Beside it other effects are looked for, as little else shows until that is said. Instead of it stands one by itself
    that leaves nothing where stray detections do, if it is among the most promising: a link that bends by much strays
    from where the simulation has it, too, and among stray detections nothing shows of that.
    """
    none = found.pool[""]
    for path in (path for path in (found.aside, found.path) if path is not None):
        for effect in (e for e in found.candidates if e.name in MISTAKES):
            base = none.moved_to(none.model, path)
            if (cause := attempt(refine_searched, problem, base, effect)) is not None:
                found.add(cause)
        if found.ranked[0].complete:
            return
    if not found.ranked[0].effects:
        return
    _, screened = screened_with(problem, found, none, True)
    tried = replace(found, pool=dict(found.pool))
    refine_promising(problem, tried, none, screened, INSTEAD)
    if tried.explained:
        found.pool, found.first = tried.pool, screened


def _singles(found: HypothesisPool) -> list[FittedHypothesis]:
    """Causes of one effect, but for those that leave stray detections."""
    return [cause for cause in found.pool.values() if len(others(cause)) == 1]


def _several(problem: DiagnosisProblem, found: HypothesisPool, screened: Sequence[Screened]) -> None:
    """Refine the best pairs, then, where they leave something, the best sets of three, and so on."""
    common, none = unknowns(problem, ()), found.pool[""].log_evidence
    for sets in together(problem, problem.model, found.path, screened, common, found.candidates, SETS):
        if len(sets[0].effects) > found.most:
            break
        for each in sets:
            top = found.top
            limits = {"enough": top - TOO_FAR_BEHIND, "doubtful": top - max(TOO_FAR_BEHIND, (1 - SHARE) * (top - none))}
            cause = attempt(refine, problem, each.effects, each.values, found.path, each.size, **limits)
            if cause is not None:
                found.add(cause)
        refine_kin(problem, found, len(sets[0].effects))
        if found.ranked[0].complete:
            break
