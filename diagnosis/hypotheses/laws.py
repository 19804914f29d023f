"""The laws under which causes are compared: sub-steps of the integrator, steps of the file's engine, tails of the
noise.

A law is no cause: it is part of the model of every cause in a pool. The more probable law is kept.

Sub-steps
---------
Integrator sub-steps whose error costs no evidence.

An error that no row shows adds up over a recording, and what takes shorter sub-steps for other reasons, as
backlash does, gains what all others lose by it. The error e_t (D,) of row t is the difference to twice as many
sub-steps along a path. As an input into the state it changes the whitened innovations by a column w
(:mod:`.innovations`), and log evidence by ½ |w|² on average; with next to no residual, which would take the error
along.

That is along a path without a cause. Where joints stick, the effect's own sub-steps do (:attr:`.Effect.max_substep`).

Steps of an engine
------------------
Whether a recording is one of the file's own engine, whose steps are of first order: the search under either law.

A robot, or an engine of high order, moves as the equations say. An engine that takes steps of h as the file asks for
(:mod:`invdyn.models.bodies.joint_parts`) errs by h/2 of the commands' rate. With a stiff servo that is like a damper,

    τ = u(t + h/2) − u(t) ≈ h/2 K ċ,        of a servo with targets c, ċ ≈ θ̇,

and would be taken for one. Both laws are as probable before, and neither is a cause. The search is made under the law
whose "no effect" is more probable. The best cause, its parts and "no effect" are then compared with the other law, and
where one of them is more probable there, the search is made under that as well:

    log p(y | cause, law) + log P(cause)

Where "no effect" leaves nothing of the equations themselves, no engine is tried.

Heavy tails
-----------
The law of a tracker's noise: where outliers were found, heavy tails may describe them better.

Student's t with ν degrees of freedom, one for both coordinates of a detection (:mod:`.multivariate_t`), competes with
the normal law (Lange, Little & Taylor 1989, JASA 84), with

    P(normal) = ½,    P(ν) = 1/6 for ν = 4, 8, 16

Heavy tails are no cause to be named. The best cause with outliers is compared with the same cause without them
under each ν, path and parameters refined. Where that is more probable, outliers are searched once more along that path.
Where it still is, so is every cause near the best: the pool is refined under that law, without outliers. The t law's
width is that of its own best fit: it is the noise of the rows between its tails. Far from its mode that law pulls
nowhere, so all are refined from what they were.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import inf, log

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.swap import without
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_mistake, is_outlier
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import filter_of, whiten
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.posterior.initialise import SUBSTEPS

WIDTH = "emission.keypoint_scale"
"""The law's width."""


def finely_stepped(problem: DiagnosisProblem, path: Tensor) -> DiagnosisProblem:
    """The problem with as many sub-steps as its own, or the fewest whose error along ``path`` (T, D) costs little.

    Under an unknown torque, which takes errors along, it stays as it is.
    """
    if not problem.regime.knows_torque:
        return problem
    model, ends = problem.model, {}
    rows = torch.arange(1, len(path))
    about = filter_of(problem, problem.model, path, np.array([problem.rules.residual.spike_size]))
    nothing = np.zeros((*problem.observations.shape, 1))

    def reached(count: int) -> Tensor:
        """States (T − 1, D) at the ends of all rows, in so many sub-steps."""
        if count not in ends:
            with torch.no_grad():
                ends[count] = model.in_substeps(count).transition_mean(path[:-1], rows)
        return ends[count]

    own = problem.model.substeps
    for count in (n for n in SUBSTEPS if own <= n <= problem.rules.search.max_step_factor * own):
        error = (reached(count) - reached(2 * count)).unsqueeze(-1).numpy()
        if 0.5 * whiten(problem, about, Columns(error, nothing)).gram[0, 1, 1] <= problem.rules.search.max_step_loss:
            break
    return problem.in_substeps(count)


def search_either(
    problem: DiagnosisProblem, path: Tensor, search: Callable[[DiagnosisProblem], HypothesisPool]
) -> HypothesisPool:
    """The pool that ``search`` finds under the more probable law; ``path`` (T, D) is the data's."""
    own, other = problem, problem.in_engine_steps()
    if other is own:
        return search(own)
    alone = attempt(refine, own, (), {}, path, own.regime.path_size)
    if alone is None or alone.complete:
        return search(own)
    stepped = attempt(refine, other, (), {}, alone.path, best_size(own, alone))
    if stepped is not None and stepped.log_evidence > alone.log_evidence:
        own, other = other, own
    found = search(own)
    best = found.best
    worth = best.log_evidence + found.log_prior(best.effects)
    if not best.effects or not any(
        c.log_evidence + found.log_prior(c.effects) > worth for c in _under(other, own, best)
    ):
        return found
    again = attempt(search, other)
    if again is None or again.best.log_evidence + found.log_prior(again.best.effects) <= worth:
        return found
    return again


def _under(law: DiagnosisProblem, own: DiagnosisProblem, best: FittedHypothesis) -> list[FittedHypothesis]:
    """A cause of its ``own`` law under another ``law``, whole, without each effect, and without any."""
    size = best_size(own, best)
    whole = attempt(refine, law, best.effects, best.values, best.path, size, **best.searched)
    if whole is None:
        return []
    parts = [attempt(without, law, whole, effect, size) for effect in best.effects if len(best.effects) > 1]
    parts.append(attempt(refine, law, (), {}, best.path, size))
    return [whole, *(part for part in parts if part is not None)]


def heavy_tailed(found: HypothesisPool) -> HypothesisPool:
    """The pool under the law with heavy tails, if that is more probable than the outliers of the best cause.

    As it is where the best cause has none, or other mistakes of the tracker, or where the budget
    ends before it is carried over.
    """
    problem, best = found.problem, found.best
    rest = _without_outliers(problem, best)
    if rest is best or any(is_mistake(effect) for effect in rest.effects):
        return found
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
        return found
    least = found.score(best) - problem.rules.search.max_tail_gap
    near = [cause for cause in found.ranked if found.score(cause) > least or not cause.effects]
    bare = {cause.key: cause for cause in (_without_outliers(problem, each) for each in reversed(near))}
    candidates = [effect for effect in found.candidates if not is_outlier(effect)]
    carried = replace(found, problem=tailed, pool={}, candidates=candidates, has_outliers=False)
    clear = [cause for cause in bare.values() if not any(is_mistake(effect) for effect in cause.effects)]
    parts = [partial(_carried, tailed, each) for each in clear]
    for cause in side_by_side(parts, found.workers, tailed.budget):
        carried.add(cause)
    return carried if {"", rest.key} <= carried.pool.keys() else found


def _without_outliers(problem: DiagnosisProblem, cause: FittedHypothesis) -> FittedHypothesis:
    """A cause without its outliers, nothing refined; itself where it has none."""
    outliers = next((effect for effect in cause.effects if problem.catalogue.of(effect).outliers), None)
    return cause if outliers is None else cause.less(problem, outliers)


def _with_outliers(
    problem: DiagnosisProblem, best: FittedHypothesis, there: FittedHypothesis
) -> FittedHypothesis | None:
    """The ``best`` cause, its outliers searched once more along the path that it has ``there``."""
    outliers = next(effect for effect in best.effects if problem.catalogue.of(effect).outliers)
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
