"""A candidate in its own right: path and parameters together, until they agree.

The screen expands every candidate about one path and about its absence. Here a candidate has a path of its own,
found by Gauss–Newton under its own dynamics with its own parameters and residual, and is expanded about the
parameters that it has reached; the regression on its columns then moves them, until they stay. It is Gauss–Newton
on path and parameters in turns, and its evidence is that of the model linearised about both: a Laplace
approximation.

Where joints stick or strike, the first path comes from a homotopy to a stiff chain (:mod:`.continuation`); in the
last, stiffer rounds that one or what Gauss–Newton finds by itself, whichever is better.

Nothing is assumed of the effects but that the model's three distributions follow their parameters smoothly enough for
differences of a twentieth of their uncertainty. Parameters of all effects in the model are free.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from scipy.special import logsumexp
from torch import Tensor

from invdyn.diagnosis.hypotheses.continuation import continued, lifted, with_smaller_residual
from invdyn.diagnosis.kept_units import kept_unit
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import Unknowns, unknowns
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.evidence import learned
from invdyn.diagnosis.sensitivity.memory import expansions
from invdyn.diagnosis.sensitivity.sensitivities import slopes
from invdyn.diagnosis.sensitivity.whiten import filter_of, whiten
from invdyn.inference.smoothing.gauss_newton import gauss_newton_path
from invdyn.models.divergence import Singular, diverging
from invdyn.models.effects.base import Effect


@kept_unit("refine", FittedHypothesis)
def refine(
    problem: DiagnosisProblem,
    effects: Sequence[Effect],
    values: Mapping[str, float],
    path: Tensor,
    size: float,
    *,
    noise_log: Mapping[str, float] | None = None,
    noise_sd: Mapping[str, float] | None = None,
    enough: float = -np.inf,
    doubtful: float = -np.inf,
    rounds: int | None = None,
) -> FittedHypothesis:
    """Refine a cause from parameter ``values`` ("<effect key>.<name>") and a path (T, D).

    ``size`` is the residual's that its first path is found under. A descent that has not reached ``doubtful`` nats
    after the first of ``rounds``, or ``enough`` after the second, ends there; so does one at which the budget ends.
    :class:`.Spent` is raised where that ends before. Parameters of effects that are searched stay where ``values`` has
    them; ``noise_log`` is what their integral adds to the log evidence, by effect's key, ``noise_sd`` their standard
    deviations.
    """
    model = problem.model.with_effects(*effects)
    effects = tuple(model.effects)
    problem.budget.start(key_of(effects) or "no effect")
    rules, patient = problem.rules.descent, rounds is None
    rounds = rounds or rules.max_rounds
    searched = {f"{e.key}.{p.name}" for e in effects if is_searched(e) for p in e.parameters(problem.model.scale)}
    noise = {name: float(values[name]) for name in searched}
    known_sd = {name: sd for name, sd in (noise_sd or {}).items() if name in noise}
    integrated = {key: log for key, log in (noise_log or {}).items() if key in {effect.key for effect in effects}}
    model = model.replace(**{f"effect.{name}": torch.tensor([v], dtype=torch.float64) for name, v in noise.items()})
    among = unknowns(problem, effects)
    point = np.array([values.get(name, mean) for name, mean in zip(among.names, among.mean, strict=True)])
    point = np.clip(point, among.lower, among.upper)
    path = lifted(among.set_in(model, point), path)
    levels = problem.regime.sizes
    nudge = problem.rules.screening.slope_step
    step = nudge * 0.2 * among.sd
    best: FittedHypothesis | None = None
    worth = most_seen = -np.inf

    def once(point: np.ndarray, path: Tensor, size: float, first: bool) -> tuple[FittedHypothesis, float]:
        """Path and expansion about ``point``: the cause where its parameters go, and the gain that promises."""
        here = among.set_in(model, point)
        quiet = problem.with_residual(max(size, problem.min_size), here)
        before = path
        path = gauss_newton_path(quiet, problem.observations, path, rules.path_steps, rules.path_tolerance)
        problem.budget.spend(rules.path_steps + FIXED.refused_steps + 0.2 * len(point), here, len(path))
        if first and torch.equal(path, before):
            # It may be so far off, as that of a noisier chain is, that no step was short enough.
            path = gauss_newton_path(quiet, problem.observations, path, rules.max_short_steps, rules.path_tolerance)
            problem.budget.spend(rules.max_short_steps, here, len(path))
        columns = slopes(model, among, point, np.maximum(step, 1e-7 * among.sd), path)
        whitened = whiten(problem, filter_of(problem, here, path, levels), columns)
        outcomes = expansions(whitened, among, point, problem.rules)
        by_size = np.array([o.log_evidence for o in outcomes]) + problem.regime.log_prior + sum(integrated.values())
        top = outcomes[int(by_size.argmax())]
        if not (np.isfinite(top.mean).all() and np.isfinite(top.covariance).all()):
            raise Singular("the expansion about these parameters is not finite")
        mean, covariance = top.mean, top.covariance
        target = within_bounds(partial(among.step, point), point, mean, covariance)
        evidence = float(logsumexp(by_size))
        cause = FittedHypothesis(
            effects,
            among.names,
            target,
            covariance,
            evidence,
            by_size,
            top.kappa,
            path,
            here,
            noise,
            known_sd,
            integrated,
            memory=top.memory,
            of_memory=top.gain,
            learned=learned(covariance, among.sd),
            far=0.5 * float((((target - among.mean) / among.sd) ** 2).sum()),
        )
        return cause, promised_gain(among, point, mean, covariance)

    def descend(point: np.ndarray, path: Tensor, size: float, stiffness: float, most: int, fresh: bool = True) -> None:
        """Expand and move on, ``most`` times at most; the best stays.

        A ``fresh`` path is another residual's or another cause's, and may need ever shorter steps to begin with.
        """
        nonlocal best, worth, most_seen, step
        for done in range(most):
            if best is not None and problem.budget.over:
                break
            try:
                with diverging():
                    cause, promised = once(point, path, stiffness * size, fresh and not done)
            except Singular:
                if best is None:
                    raise
                break  # a step too far; what was found before it stands
            used, size, path, sd = size, best_size(problem, cause), cause.path, cause.sd
            step = nudge * sd
            off = np.abs(cause.mean - point) / np.maximum(sd, 1e-300)
            # Evidence is that of a straight line from the point on: what it promises, the next round has to keep.
            true = cause.log_evidence - promised
            if best is None or true > most_seen - rules.unseen_gain:
                # Of rounds that are as good the last one: where it was expanded is nearest to where it ends.
                best, worth, most_seen = replace(cause, about=point), true, max(true, most_seen)
            hopeless = cause.log_evidence < (enough if done else doubtful) and cause.kappa < rules.max_lost_kappa
            # A path that was found under another residual is bent by it.
            # Where several parameters are known only together, a step that is short in each may be a long one.
            settled = (off < rules.settled_sds).all() and promised < rules.unseen_gain
            if (settled and max(used, problem.min_size) == max(size, problem.min_size)) or hopeless:
                break
            point = cause.mean

    if patient and model.effects.abrupt:
        # Where joints stick or strike, a path that leaves much to the residual misleads.
        descend(point, continued(problem, among.set_in(model, point), path, problem.min_size), problem.min_size, 1.0, 3)
    if best is None or not best.complete:
        descend(point, path, size, 1.0, rounds)
    assert best is not None  # a first step that fails raises
    # Then stiffer: a residual that bends the path lets wrong parameters stand, where there are any.
    for stiffness in (0.1, 0.0) if among.names else ():
        if patient and not best.complete and best.log_evidence >= enough and not problem.budget.over:
            size = best_size(problem, best)
            stiff = with_smaller_residual(problem, among.set_in(model, best.mean), best.path, stiffness * size)
            descend(best.mean, stiff, size, stiffness, 2)
    if patient and best.log_evidence >= enough and best.log_evidence - worth > rules.unseen_gain:
        descend(best.mean, best.path, best_size(problem, best), 0.0, rounds, fresh=False)
    if rounds > 1 and best.about is not None and (excess := best.log_evidence - worth) > rules.unseen_gain:
        # It never came to rest: what it is known to be worth is where it was expanded.
        best = replace(best, mean=best.about, log_evidence=worth, by_size=best.by_size - excess)
    return replace(best, model=among.set_in(model, best.mean), plausible=among.plausible(best.mean))


def within_bounds(
    bounded: Callable[[np.ndarray], np.ndarray], point: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Where a step of N(mean, covariance) ends from ``point`` within bounds: at a bound, the others given that."""
    whole = target = point + mean
    at_bound = np.zeros(len(point), dtype=bool)
    while True:
        within = bounded(target)
        over = ~at_bound & (within != target)
        if not over.any():
            return within
        at_bound |= over
        free = ~at_bound
        own, others = covariance[np.ix_(at_bound, at_bound)], covariance[np.ix_(at_bound, free)]
        gain, *_ = np.linalg.lstsq(own, others, rcond=None)
        target = within.copy()
        target[free] = whole[free] + gain.T @ (within - whole)[at_bound]


def promised_gain(among: Unknowns, point: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> float:
    """Nats that the evidence of N(mean, covariance) about ``point`` has over what is seen there.

    That evidence is cut at the parameters' bounds, but not where a step is shortened for other reasons:
    ½ (|m|² − |m − x|²), where x is as much of the whole step m as bounds allow.
    """
    allowed = within_bounds(partial(np.clip, a_min=among.lower, a_max=among.upper), point, mean, covariance) - point
    return max(0.5 * (squared_distance(mean, covariance) - squared_distance(mean - allowed, covariance)), 0.0)


def squared_distance(step: np.ndarray, covariance: np.ndarray) -> float:
    """Squared length of a step in standard deviations of a Gaussian."""
    return float(step @ np.linalg.lstsq(covariance, step, rcond=None)[0]) if len(step) else 0.0
