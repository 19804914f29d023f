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
from invdyn.models import ArmModel
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
    problem.budget.start(key_of(tuple(model.effects)) or "no effect")
    patient = rounds is None
    rounds = rounds or problem.rules.descent.max_rounds
    descent = _Descent(problem, model, values, noise_log or {}, noise_sd or {}, enough, doubtful)
    among = descent.among
    point = np.array([values.get(name, mean) for name, mean in zip(among.names, among.mean, strict=True)])
    point = np.clip(point, among.lower, among.upper)
    path = lifted(descent.with_parameters(point), path)
    if patient and model.effects.abrupt:
        # Where joints stick or strike, a path that leaves much to the residual misleads.
        smooth = continued(problem, descent.with_parameters(point), path, problem.min_size)
        descent.descend(point, smooth, problem.min_size, 1.0, 3)
    if descent.best is None or not descent.best.complete:
        descent.descend(point, path, size, 1.0, rounds)
    best = descent.stiffened(rounds) if patient else descent.best
    assert best is not None  # a first step that fails raises
    if rounds > 1 and best.about is not None and (excess := best.log_evidence - descent.worth) > descent.unseen_gain:
        # It never came to rest: what it is known to be worth is where it was expanded.
        best = replace(best, mean=best.about, log_evidence=descent.worth, by_size=best.by_size - excess)
    return replace(best, model=descent.with_parameters(best.mean), plausible=among.plausible(best.mean))


class _Descent:
    """Rounds of path and parameters in turns, and the best of them.

    Attributes:
        among: the parameters that are free.
        best: of all rounds.
        worth, most_seen: log evidence of the best one, and of any, where it was expanded.
    """

    def __init__(
        self,
        problem: DiagnosisProblem,
        model: ArmModel,
        values: Mapping[str, float],
        noise_log: Mapping[str, float],
        noise_sd: Mapping[str, float],
        enough: float,
        doubtful: float,
    ):
        self.problem, self.effects, self.enough, self.doubtful = problem, tuple(model.effects), enough, doubtful
        scale = problem.model.scale
        searched = {f"{e.key}.{p.name}" for e in self.effects if is_searched(e) for p in e.parameters(scale)}
        self.noise = {name: float(values[name]) for name in searched}
        self.known_sd = {name: sd for name, sd in noise_sd.items() if name in self.noise}
        keys = {effect.key for effect in self.effects}
        self.integrated = {key: log for key, log in noise_log.items() if key in keys}
        as_searched = {f"effect.{name}": torch.tensor([v], dtype=torch.float64) for name, v in self.noise.items()}
        self.model = model.replace(**as_searched)
        self.among = unknowns(problem, self.effects)
        self.nudge, self.unseen_gain = problem.rules.screening.slope_step, problem.rules.descent.unseen_gain
        self.step = self.nudge * 0.2 * self.among.sd
        self.best: FittedHypothesis | None = None
        self.worth = self.most_seen = -np.inf

    def with_parameters(self, point: np.ndarray) -> ArmModel:
        return self.among.set_in(self.model, point)

    def descend(
        self, point: np.ndarray, path: Tensor, size: float, stiffness: float, most: int, fresh: bool = True
    ) -> None:
        """Expand and move on, ``most`` times at most; the best stays.

        A ``fresh`` path is another residual's or another cause's, and may need ever shorter steps to begin with.
        """
        problem, rules = self.problem, self.problem.rules.descent
        for done in range(most):
            if self.best is not None and problem.budget.over:
                break
            try:
                with diverging():
                    cause, promised = self._once(point, path, stiffness * size, fresh and not done)
            except Singular:
                if self.best is None:
                    raise
                break  # a step too far; what was found before it stands
            used, size, path, sd = size, best_size(problem, cause), cause.path, cause.sd
            self.step = self.nudge * sd
            off = np.abs(cause.mean - point) / np.maximum(sd, 1e-300)
            # Evidence is that of a straight line from the point on: what it promises, the next round has to keep.
            true = cause.log_evidence - promised
            if self.best is None or true > self.most_seen - self.unseen_gain:
                # Of rounds that are as good the last one: where it was expanded is nearest to where it ends.
                self.best, self.worth, self.most_seen = replace(cause, about=point), true, max(true, self.most_seen)
            least = self.enough if done else self.doubtful
            hopeless = cause.log_evidence < least and cause.kappa < rules.max_unfitted_kappa
            # A path that was found under another residual is bent by it.
            # Where several parameters are known only together, a step that is short in each may be a long one.
            settled = (off < rules.settled_sds).all() and promised < self.unseen_gain
            if (settled and max(used, problem.min_size) == max(size, problem.min_size)) or hopeless:
                break
            point = cause.mean

    def stiffened(self, rounds: int) -> FittedHypothesis | None:
        """The best once stiffer: a residual that bends the path lets wrong parameters stand, where there are any."""
        for stiffness in (0.1, 0.0) if self.among.names else ():
            best = self.best
            if best is None or best.complete or self.problem.budget.over or not best.log_evidence >= self.enough:
                break
            size = best_size(self.problem, best)
            here = self.with_parameters(best.mean)
            stiff = with_smaller_residual(self.problem, here, best.path, stiffness * size)
            self.descend(best.mean, stiff, size, stiffness, 2)
        best = self.best
        if best is not None and best.log_evidence >= self.enough and best.log_evidence - self.worth > self.unseen_gain:
            self.descend(best.mean, best.path, best_size(self.problem, best), 0.0, rounds, fresh=False)
        return self.best

    def _once(self, point: np.ndarray, path: Tensor, size: float, first: bool) -> tuple[FittedHypothesis, float]:
        """Path and expansion about ``point``: the cause where its parameters go, and the gain that promises."""
        problem, among, here = self.problem, self.among, self.with_parameters(point)
        path = self._path(point, path, here, size, first)
        columns = slopes(self.model, among, point, np.maximum(self.step, 1e-7 * among.sd), path)
        whitened = whiten(problem, filter_of(problem, here, path, problem.regime.sizes), columns)
        outcomes = expansions(whitened, among, point, problem.rules)
        by_size = (
            np.array([o.log_evidence for o in outcomes]) + problem.regime.log_prior + sum(self.integrated.values())
        )
        top = outcomes[int(by_size.argmax())]
        if not (np.isfinite(top.mean).all() and np.isfinite(top.covariance).all()):
            raise Singular("the expansion about these parameters is not finite")
        mean, covariance = top.mean, top.covariance
        target = within_bounds(partial(among.step, point), point, mean, covariance)
        far = 0.5 * float((((target - among.mean) / among.sd) ** 2).sum())
        cause = FittedHypothesis(
            self.effects, among.names, target, covariance, float(logsumexp(by_size)), by_size, top.kappa, path, here,
            self.noise, self.known_sd, self.integrated,
            memory=top.memory, of_memory=top.gain, learned=learned(covariance, among.sd), far=far,
        )  # fmt: skip
        return cause, promised_gain(among, point, mean, covariance)

    def _path(self, point: np.ndarray, path: Tensor, here: ArmModel, size: float, first: bool) -> Tensor:
        """The most probable one of ``here``, from ``path`` on."""
        problem, rules = self.problem, self.problem.rules.descent
        quiet = problem.with_residual(max(size, problem.min_size), here)
        before = path
        path = gauss_newton_path(quiet, problem.observations, path, rules.path_steps, rules.path_tolerance)
        problem.budget.spend(rules.path_steps + FIXED.refused_steps + 0.2 * len(point), here, len(path))
        if first and torch.equal(path, before):
            # It may be so far off, as that of a noisier chain is, that no step was short enough.
            path = gauss_newton_path(quiet, problem.observations, path, rules.max_short_steps, rules.path_tolerance)
            problem.budget.spend(rules.max_short_steps, here, len(path))
        return path


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
