"""The law of a tracker's noise: where outliers were found, heavy tails may describe them better.

Student's t with ν degrees of freedom, one for both coordinates of a detection (:mod:`.multivariate_t`), competes with
the normal law (Lange, Little & Taylor 1989, JASA 84), with

    P(normal) = ½,    P(ν) = 1/6 for ν = 4, 8, 16

Heavy tails are no cause to be named. The best cause with outliers is compared with the same cause without them
under each ν, path and parameters refined. Where that is more probable, outliers are searched once more along that path.
Where it still is, so is every cause near the best: the pool is refined under that law, without outliers. The t law's
width is that of its own best fit: it is the noise of the rows between its tails. Far from its mode that law pulls
nowhere, so all are refined from what they were.
"""

from dataclasses import replace
from functools import partial
from math import inf, log

import torch

from invdyn.diagnosis.hypotheses.attempt import attempt
from invdyn.diagnosis.hypotheses.pool import MISTAKES, HypothesisPool
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_mistake
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.side_by_side import side_by_side

WIDTH = "emission.keypoint_scale"
"""The law's width."""


def heavy_tailed(problem: DiagnosisProblem, found: HypothesisPool) -> tuple[DiagnosisProblem, HypothesisPool]:
    """Problem and pool under the law with heavy tails, if that is more probable than the outliers of the best cause.

    Both as they are where the best cause has none, or other mistakes of the tracker, or where the budget
    ends before it is carried over.
    """
    best = found.best
    rest = _without_outliers(problem, best)
    if rest is best or any(is_mistake(type(effect)) for effect in rest.effects):
        return problem, found
    degrees = problem.rules.residual.tail_degrees
    laws = [_fitted(problem, rest, each) for each in degrees]
    worth, tailed, there = max(laws, key=lambda law: law[0])
    named, unnamed = (found.log_prior(each.effects) for each in (best, rest))
    # Log evidence up to which outliers are less probable.
    rivals = worth - log(len(degrees)) + unnamed - named
    if best.log_evidence <= rivals:
        # It may be the path: where no torque constrains it, Gauss–Newton bends it to outliers.
        found.add(_with_outliers(problem, best, there))
    if found.pool[best.key].log_evidence > rivals:
        return problem, found
    least = found.score(best) - problem.rules.search.max_tail_gap
    near = [cause for cause in found.ranked if found.score(cause) > least or not cause.effects]
    bare = {cause.key: cause for cause in (_without_outliers(problem, each) for each in reversed(near))}
    candidates = [effect for effect in found.candidates if effect.name not in MISTAKES]
    carried = replace(found, pool={}, candidates=candidates, has_outliers=False)
    clear = [cause for cause in bare.values() if not any(is_mistake(type(effect)) for effect in cause.effects)]
    parts = [partial(_carried, tailed, each) for each in clear]
    for cause in side_by_side(parts, found.workers, tailed.budget):
        carried.add(cause)
    return (tailed, carried) if {"", rest.key} <= carried.pool.keys() else (problem, found)


def _without_outliers(problem: DiagnosisProblem, cause: FittedHypothesis) -> FittedHypothesis:
    """A cause without its outliers, nothing refined; itself where it has none."""
    outliers = next((effect for effect in cause.effects if effect.name == "outliers"), None)
    return cause if outliers is None else cause.less(problem, outliers)


def _with_outliers(
    problem: DiagnosisProblem, best: FittedHypothesis, there: FittedHypothesis
) -> FittedHypothesis | None:
    """The ``best`` cause, its outliers searched once more along the path that it has ``there``."""
    outliers = next(effect for effect in best.effects if effect.name == "outliers")
    among = unknowns(problem, there.effects)
    model = among.set_in(_without_outliers(problem, best).model, there.mean)
    base = replace(_without_outliers(problem, best), model=model, path=there.path, mean=there.mean, log_evidence=-inf)
    return attempt(refine_searched, problem, base, outliers)


def _carried(problem: DiagnosisProblem, cause: FittedHypothesis) -> FittedHypothesis | None:
    """A cause under the problem's law, refined from what it is under another."""
    size = best_size(problem, cause)
    return attempt(refine, problem, cause.effects, cause.values, cause.path, size, **cause.searched)


def _fitted(
    problem: DiagnosisProblem, cause: FittedHypothesis, degrees: float
) -> tuple[float, DiagnosisProblem, FittedHypothesis]:
    """Log evidence of a cause under Student's t, the problem under it, and the cause; −∞ where it cannot be refined."""
    model = problem.model.observed_by(problem.model.observation.with_family("multivariate_t"))
    model = model.replace(**{"emission.df": torch.full((1,), degrees, dtype=model.dtype)})
    tailed = problem
    for _ in range(problem.rules.search.num_tail_fits):
        tailed = replace(problem, problem=replace(problem.problem, model=model))
        refined = _carried(tailed, cause)
        if refined is None:
            return -inf, tailed, cause
        model = model.replace(**{WIDTH: refined.kappa * model.parameters[WIDTH]})
        cause = refined
    return cause.log_evidence, tailed, cause
