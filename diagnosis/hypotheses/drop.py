"""The move to drop: a set without one of its effects, from the set's path and values.

Forward selection fails where effects imitate others together; backward steps repair it (Miller 2002, "Subset
selection in regression", ch. 3). A set may be what it took to get near the parameters of one of its members.
"""

from invdyn.diagnosis.hypotheses.attempt import attempt
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import refine_regularised
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.models.effects.base import Effect


def drop(problem: DiagnosisProblem, found: HypothesisPool, best: FittedHypothesis) -> None:
    """Leave out each effect of the best set; what accompanied an ideal law may replace the regularised form of it."""
    for effect in best.effects:
        found.add(attempt(without, problem, best, effect, problem.min_size))
        rest = key_of([other for other in best.effects if other is not effect])
        if rest in found.pool:
            refine_regularised(problem, found, found.pool[rest])


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
