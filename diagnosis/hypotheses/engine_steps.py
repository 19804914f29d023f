"""Whether a recording is one of the file's own engine, whose steps are of first order: the search under either law.

A robot, or an engine of high order, moves as the equations say. An engine that takes steps of h as the file asks for
(:mod:`invdyn.models.bodies.joint_parts`) errs by h/2 of the commands' rate. With a stiff servo that is like a damper,

    τ = u(t + h/2) − u(t) ≈ h/2 K ċ,        of a servo with targets c, ċ ≈ θ̇,

and would be taken for one. Both laws are as probable before, and neither is a cause. Under the law whose "no effect" is
likelier the search is made. The best cause, its parts and "no effect" are then compared with the other law, and where
one of them is likelier there, the search is made under that as well:

    log p(y | cause, law) + log P(cause)

Where "no effect" leaves nothing of the equations themselves, no engine is tried.
"""

from collections.abc import Callable

from torch import Tensor

from invdyn.diagnosis.hypotheses.attempt import attempt
from invdyn.diagnosis.hypotheses.drop import without
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem


def search_either(
    problem: DiagnosisProblem, path: Tensor, search: Callable[[DiagnosisProblem], HypothesisPool]
) -> tuple[DiagnosisProblem, HypothesisPool]:
    """The likelier law's problem, and the pool that ``search`` finds under it; ``path`` (T, D) is the data's."""
    own, other = problem, problem.in_engine_steps()
    if other is own:
        return own, search(own)
    alone = attempt(refine, own, (), {}, path, own.regime.path_size)
    if alone is None or alone.complete:
        return own, search(own)
    stepped = attempt(refine, other, (), {}, alone.path, best_size(own, alone))
    if stepped is not None and stepped.log_evidence > alone.log_evidence:
        own, other = other, own
    found = search(own)
    best = found.best
    worth = best.log_evidence + found.log_prior(best.effects)
    if not best.effects or not any(
        c.log_evidence + found.log_prior(c.effects) > worth for c in _under(other, own, best)
    ):
        return own, found
    again = attempt(search, other)
    if again is None or again.best.log_evidence + found.log_prior(again.best.effects) <= worth:
        return own, found
    return other, again


def _under(law: DiagnosisProblem, own: DiagnosisProblem, best: FittedHypothesis) -> list[FittedHypothesis]:
    """A cause of its ``own`` law under another ``law``, whole, without each effect, and without any."""
    size = best_size(own, best)
    whole = attempt(refine, law, best.effects, best.values, best.path, size, **best.searched)
    if whole is None:
        return []
    parts = [attempt(without, law, whole, effect, size) for effect in best.effects if len(best.effects) > 1]
    parts.append(attempt(refine, law, (), {}, best.path, size))
    return [whole, *(part for part in parts if part is not None)]
