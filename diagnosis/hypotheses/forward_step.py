"""One more effect beside a base: every one that may join it screened, the most promising refined and kept.

Screened along the base's path; the first effect of all along the simulation's own, too. Beside those that the screen
ranks (:mod:`.shortlist`) come those whose parameters are searched (:mod:`.noise`): what changes the scatter, and play.

With unknown torque only what the camera shows is refined (:func:`.shortlist.refine_promising`): if it gains more than
what a torque imitates, or where errors of prediction show that something is left whatever the torque does.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from invdyn.diagnosis.hypotheses.innovation_tests import prediction_errors, show_more
from invdyn.diagnosis.hypotheses.moves import refine_kin
from invdyn.diagnosis.hypotheses.pool import MISTAKES, HypothesisPool, others
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.shortlist import (
    SHARE,
    TOO_FAR_BEHIND,
    attempt,
    idle,
    refine_barred,
    refine_promising,
)
from invdyn.diagnosis.hypotheses.swap_step import free_beside
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import Screened, screen, screen_in_halves
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import HiddenHinge


def extend(problem: DiagnosisProblem, found: HypothesisPool, base: FittedHypothesis, width: int) -> list[Screened]:
    """Screen every effect that may join ``base``, refine and keep the best ``width``; the screen along its path."""
    taken = {effect.key for effect in base.effects}
    free = [e for e in found.candidates if e.key not in taken]
    known = problem.regime.knows_torque
    alone = known and not others(base)
    screened, best = screened_with(problem, found, base, alone)
    found.first = found.first or best
    refine_promising(problem, found, base, best, width)
    refine_kin(problem, found, len(base.effects) + 1)
    least = -np.inf if known else idle(screened)
    if not known and show_more(problem, found.ranked[0], prediction_errors(problem, found.ranked[0])):
        refine_barred(problem, found, base, best)
        least = -np.inf
    refine_searchable(problem, found, base, free, least)
    return screened


def screened_with(
    problem: DiagnosisProblem, found: HypothesisPool, base: FittedHypothesis, alone: bool
) -> tuple[list[Screened], list[Screened]]:
    """The screen beside ``base`` along its path, and, of the first effect (``alone``), each where it does best."""
    straight, common = free_beside(found, base.effects), unknowns(problem, base.effects)
    if base.effects:
        model, path, point = base.model, base.path, base.mean
    else:
        # The body as it is stated: without a cause its numbers have been bent to stand in for one.
        model, path, point = problem.model, found.path, common.mean
    few = base.complete and bool(base.effects)
    # A screen takes as long as what it screens is much: in two halves, or along two paths.
    if alone and not few and found.aside is not None:
        parts = [partial(screen, problem, model, along, straight, common, point) for along in (path, found.aside)]
        screened, other = side_by_side(parts, found.workers, problem.budget)
        return screened, _aside(screened, other)
    screened = screen_in_halves(found.workers, problem, model, path, straight, common, point, few)
    return screened, screened


def refine_searchable(
    problem: DiagnosisProblem, found: HypothesisPool, base: FittedHypothesis, free: Sequence[Effect], least: float
) -> None:
    """Search parameters that no column describes beside ``base``: of what changes the scatter alone, and of play.

    Each is given up under ``least`` nats, scatter also far behind the best cause. Play takes minutes: it is looked for
    beside no effect or one that does not stick, if nothing else explains the gap, or a small one, as what gains little
    play may imitate, or be imitated by. It must make good a share of what its base is behind.
    """
    beside = others(base)
    slips = len(beside) < 2 and not base.model.effects.has_friction and problem.regime.knows_torque
    # Beside what explains less than stray detections do, they come first.
    slips = slips and (not beside or base.log_evidence > found.cleaned - TOO_FAR_BEHIND)
    settled = bool(base.effects) and base.complete
    plain = found.explained and (settled or found.top > base.log_evidence + TOO_FAR_BEHIND)
    fair = base.log_evidence + SHARE * (found.top - base.log_evidence)

    def searched(effect: Effect) -> list[FittedHypothesis | None]:
        enough = fair if isinstance(effect, HiddenHinge) else found.top - TOO_FAR_BEHIND
        return [attempt(refine_searched, problem, base, effect, max(enough, least))]

    free = [e for e in free if is_searched(e) and (found.stray or e.name not in MISTAKES)]
    wanted = [e for e in free if not isinstance(e, HiddenHinge) or (slips and not plain)]
    found.add_all(problem, [partial(searched, effect) for effect in wanted])


def _aside(along: Sequence[Screened], aside: Sequence[Screened]) -> list[Screened]:
    """Effects, and none, stand where they do best: along the data's path, or ``aside``, along the simulation's own.

    A large residual lets the arm follow the data, noise and all: what the camera makes of them shows beside a path
    that does not, and so does a small inertia, which acceleration brings out.
    """
    other = {s.effect and s.effect.key: s for s in aside}
    best = [max(s, other[s.effect and s.effect.key], key=lambda s: s.log_evidence) for s in along]
    return sorted(best, key=lambda s: -s.log_evidence)
