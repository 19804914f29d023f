"""The move to add: one more effect with a base; all that may join are screened, the most promising refined.

The screen is along the base's path; of the first effect of all along the simulation's own, too. A refinement costs some
twenty times what a screen does, and the screen errs: by a few nats where a base leaves nothing, elsewhere the more,
the more there is to gain (benchmarks/expected_gain.py). An effect is refined if it may raise the posterior, and if what
it may gain, by

    s + max(60, 9 s)     where nothing explains the gap yet,      s + max(60, s)     where something does,

of s nats in the screen, is as much as what the screen's best gains. One that would need values beyond what is plausible
is refined in its regularised form, too: they may stand for what the ideal law lacks. Then come the neighbours
(:mod:`.swap`), and effects whose parameters are searched (:mod:`.profile_likelihood`).

With an unknown torque, one that only the camera shows must gain more than what a torque could do as well,
unless errors of prediction show that something is left with any torque: a large effect on what is seen bends
the path that the screen is along, and what one on the motion gains is the torque's prior's mistake.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, needed, others
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import early_stop_limits, follow_neighbours, regularised
from invdyn.diagnosis.prediction.innovation_tests import prediction_errors, show_more
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_outlier, is_searched
from invdyn.diagnosis.problem.regime import imitable
from invdyn.diagnosis.problem.unknowns import expanded_about
from invdyn.diagnosis.rules import Rules
from invdyn.diagnosis.sensitivity.screen import Added, Screened, added, screen, screen_in_halves
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import Follower, Hidden, HiddenHinge


def add(found: HypothesisPool, base: FittedHypothesis) -> None:
    """Screen every effect that may join ``base``, refine and keep the best."""
    problem = found.problem
    known, number = problem.regime.knows_torque, len(base.effects) + 1
    screened = screened_with(found, base)
    found.first = found.first or screened
    limits = problem.rules.search
    width = limits.max_candidates_added if others(base) else limits.max_candidates_alone
    refined = refine_best(found, base, screened, width)
    follow_neighbours(found, number)
    least = -np.inf if known else best_imitable_evidence(screened)
    if not known and show_more(problem, found.best, prediction_errors(problem, found.best)):
        tried = {s.effect.key for s in refined}
        barred = [s for s in _seen(screened, problem.rules) if s.effect.key not in tried]
        barred = [s for s in barred if _may_show(problem, s, _nothing(screened))]
        found.add_all([partial(_refined, problem, base, each, {}) for each in barred])
        follow_neighbours(found, number)
        least = -np.inf
    _search_values(found, base, least)


def screened_with(found: HypothesisPool, base: FittedHypothesis) -> list[Screened]:
    """The screen with ``base`` along its path; of the first effect of all, each where it does best."""
    problem = found.problem
    free, (model, common, point) = joinable(found, base.effects), expanded_about(problem, base)
    path, few = (base.path if base.effects else found.path), base.complete and bool(base.effects)
    # A screen takes as long as what it screens is much: in two halves, or along two paths.
    if not others(base) and not few and found.simulation_path is not None:
        parts = [partial(screen, problem, model, along, free, common, point) for along in (path, found.simulation_path)]
        return better_of(*side_by_side(parts, found.workers, problem.budget))
    return screen_in_halves(found.workers, problem, model, path, free, common, point, few)


def joinable(found: HypothesisPool, taken: Sequence[Effect], *but: Effect) -> list[Effect]:
    """Effects with columns that may join those that are ``taken``, ``but`` for some."""
    keys = {effect.key for effect in (*taken, *but)}
    busy = any(isinstance(effect, Hidden) and not isinstance(effect, Follower) for effect in taken)
    free = [e for e in found.candidates if e.key not in keys and not is_searched(e)]
    return [e for e in free if not (busy and isinstance(e, HiddenHinge))]


def better_of(along: Sequence[Screened], simulated: Sequence[Screened]) -> list[Screened]:
    """Effects, and none, where they do best: along the data's path, or along the simulation's own.

    A large residual lets the arm follow the data, noise and all: what the camera makes of them shows along a path
    that does not, and so does a small inertia, which acceleration brings out.
    """
    other = {s.effect and s.effect.key: s for s in simulated}
    best = [max(s, other[s.effect and s.effect.key], key=lambda s: s.log_evidence) for s in along]
    return sorted(best, key=lambda s: -s.log_evidence)


def _promising(found: HypothesisPool, base: FittedHypothesis, screened: Sequence[Screened]) -> list[Added]:
    """Screened effects that may raise the posterior, added to ``base``: it has their prior against it."""
    nothing, temper = _nothing(screened), found.temper
    least = found.log_prior(base.effects) - found.rules.search.screen_error

    def worth(s: Added) -> bool:
        prior = found.log_prior((*base.effects, s.effect))
        return temper * (s.log_evidence - nothing) + prior > least

    return [s for s in added(screened) if worth(s)]


def _seen(screened: Sequence[Screened], rules: Rules) -> list[Added]:
    """Effects that no torque imitates, and that this recording could show."""
    return [s for s in added(screened) if not imitable(s.effect) and s.dprime > rules.evidence.min_dprime]


def _may_show(problem: DiagnosisProblem, s: Added, nothing: float) -> bool:
    """Whether an effect gains anything, or has a regularised form, which may where the ideal law explains nothing."""
    gains = s.log_evidence > nothing + problem.rules.search.screen_error
    return gains or problem.catalogue.nonideal(s.effect) is not None


def refine_best(found: HypothesisPool, base: FittedHypothesis, screened: Sequence[Screened], width: int) -> list[Added]:
    """Refine the ``width`` most promising, a pair at a time, as long as one may gain what the screen's best one does.

    The first one alone: it may leave nothing, and spare the others. What was refined is returned.
    """
    problem = found.problem
    nothing = _nothing(screened)
    if problem.regime.knows_torque:
        wanted = _promising(found, base, screened)
    else:
        wanted = [s for s in _seen(screened, problem.rules) if s.log_evidence > best_imitable_evidence(screened)]
    few, refined, size = wanted[:width], list[Added](), problem.rules.search.batch_size
    for pair in (few[:1], *(few[i : i + size] for i in range(1, len(few), size))):
        gain = screened[0].log_evidence - nothing
        least = nothing + needed(gain, explained=found.best.complete, rules=problem.rules)
        pair = [each for each in pair if not refined or each.log_evidence >= least]
        found.add_all([partial(_refined, problem, base, each, early_stop_limits(found, base)) for each in pair])
        refined += pair
    return refined


def _refined(
    problem: DiagnosisProblem, base: FittedHypothesis, each: Added, limits: dict[str, Any]
) -> list[FittedHypothesis | None]:
    """``base`` and a screened effect, from the screen's values, and from the next best time where they leave a rest."""
    refined: list[FittedHypothesis | None] = []
    for start in filter(None, (each.values, each.elsewhere)):
        values = {f"{each.effect.key}.{name}": value for name, value in start.items()} | base.values
        effects = (*base.effects, each.effect)
        cause = attempt(refine, problem, effects, values, each.path, each.size, **base.searched, **limits)
        if cause is not None and not cause.plausible and cause.log_evidence > limits.get("enough", -np.inf):
            cause = regularised(problem, cause, each.effect, **limits) or cause
        if cause is not None:
            refined.append(cause)
            if cause.complete:
                break
    return refined


def _search_values(found: HypothesisPool, base: FittedHypothesis, least: float) -> None:
    """Search parameters that no column describes: of what changes the scatter alone, and of backlash.

    Each is given up under ``least`` nats, scatter also far behind the best cause. Backlash takes minutes: it is tried
    with no effect or one that does not stick, if nothing else explains the gap, or a small one, as backlash may imitate
    a small gain. It must make up for a share of what its base is behind.
    """
    problem = found.problem
    known, behind = others(base), found.top - base.log_evidence
    errs = problem.rules.search.large_screen_error
    slips = len(known) < 2 and not base.model.effects.changes("friction") and problem.regime.knows_torque
    # Outliers come before what explains less than they do.
    slips = slips and (not known or base.log_evidence > found.cleaned - errs)
    slips = slips and not (found.explained and ((base.effects and base.complete) or behind > errs))

    for_gaps = base.log_evidence + behind / problem.rules.search.unexplained_factor

    def searched(effect: Effect) -> list[FittedHypothesis | None]:
        enough = for_gaps if isinstance(effect, HiddenHinge) else found.top - errs
        return [attempt(refine_searched, problem, base, effect, max(enough, least))]

    keys = {effect.key for effect in base.effects}
    free = [e for e in found.candidates if e.key not in keys and is_searched(e)]
    free = [e for e in free if slips or not isinstance(e, HiddenHinge)]
    free = [e for e in free if found.has_outliers or not is_outlier(e)]
    found.add_all([partial(searched, effect) for effect in free])


def best_imitable_evidence(screened: Sequence[Screened]) -> float:
    """The highest evidence of effects that an unknown torque imitates: so many nats its prior gives for nothing."""
    return max(s.log_evidence for s in screened if s.effect is None or imitable(s.effect))


def _nothing(screened: Sequence[Screened]) -> float:
    """Log evidence of "no effect"."""
    return next(s.log_evidence for s in screened if s.effect is None)
