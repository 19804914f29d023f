"""Backlash added to a base: its width, by the evidence of a path of its own for each.

Backlash acts when its gap is crossed, and along the path of another width, or of none, little shows of what it
explains. So each width gets a path of its own by a homotopy from the base's (:func:`.continuation.continued`), along
which the base's unknowns are refined. The evidence there is smooth in the width's logarithm and has one top, far
from it too. Steps lead there, then parabolas,

    log Z(x ± h),  log Z(x):   top  x + h (r − l) / 2c,   variance  h² / c,   c = 2 log Z(x) − l − r,

and the last one is the width's posterior (Laplace). A grid along the base's own path says whether that is worth its
time, and where to begin.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from scipy.special import logsumexp

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.hypotheses.continuation import continued, lifted
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.simplex_search import grid, log_density_of
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import bounds, unknowns
from invdyn.diagnosis.rules import DEFAULT, FIXED, Rules
from invdyn.diagnosis.sensitivity.memory import expansions
from invdyn.diagnosis.sensitivity.sensitivities import slopes
from invdyn.diagnosis.sensitivity.whiten import filter_of, whiten
from invdyn.models import ArmModel
from invdyn.models.effects.base import Effect
from invdyn.models.effects.scale import Parameter


@dataclass
class BacklashFit:
    """Backlash of a joint added to a base, at any width.

    Attributes:
        problem, base, effect: what is diagnosed, the cause that backlash joins, and that of one joint, bound.
        parameter: its width, rad.
        tried: cause by width; None where the simulation does not run.
    """

    problem: DiagnosisProblem
    base: FittedHypothesis
    effect: Effect
    parameter: Parameter
    tried: dict[float, FittedHypothesis | None] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The width's, "backlash.elbow.width"."""
        return f"{self.effect.key}.{self.parameter.name}"

    @property
    def best(self) -> FittedHypothesis | None:
        """Of all widths that were tried."""
        return max((c for c in self.tried.values() if c is not None), key=lambda c: c.log_evidence, default=None)

    def model(self, width: float) -> ArmModel:
        """The base's with backlash of a width, rad."""
        model = self.base.model.with_effects(self.effect)
        return model.replace(**{f"effect.{self.name}": torch.tensor([width], dtype=torch.float64)})

    def along_base(self, widths: Sequence[float]) -> list[float]:
        """Log evidence of each width along the base's own path, with the gap as that drives it."""
        problem, base, levels = self.problem, self.base, self.problem.regime.sizes
        common, gained = unknowns(problem, base.effects), []
        for model in map(self.model, widths):
            path = lifted(model, base.path)
            columns = slopes(model, common, base.mean, problem.rules.screening.slope_step * base.sd, path)
            whitened = whiten(problem, filter_of(problem, model, path, levels), columns)
            evidence = np.array([o.log_evidence for o in expansions(whitened, common, base.mean, problem.rules)])
            gained.append(float(logsumexp(evidence + problem.regime.log_prior)) + sum(base.noise_log.values()))
        return gained

    def refined(self, width: float) -> FittedHypothesis:
        """The base's unknowns, from those of the nearest width, along a path from a homotopy.

        Or along the best one's own, if that is near.
        """
        known = [cause for cause in self.tried.values() if cause is not None]
        nearest = min(known, key=lambda cause: abs(cause.noise[self.name] - width), default=self.base)
        model, effects = self.model(width), (*self.base.effects, self.effect)
        rules, best = self.problem.rules.descent, self.best
        if best is not None and abs(np.log(width / best.noise[self.name])) < rules.near_width:
            path = best.path
        else:
            path = continued(self.problem, model, lifted(model, self.base.path), self.problem.min_size)
        values = nearest.values | {self.name: width}
        size, searched = self.problem.min_size, self.base.searched
        return refine(self.problem, effects, values, path, size, **searched, rounds=rules.width_rounds)

    def score(self, log_width: float) -> float:
        """Log evidence and log prior of a width's logarithm; wider than there may be, of the widest."""
        width = min(float(np.exp(log_width)), bounds(self.parameter, self.problem.rules)[1])
        if width not in self.tried:
            self.problem.budget.start(key_of((*self.base.effects, self.effect)))
            self.tried[width] = attempt(self.refined, width)
        if (cause := self.tried[width]) is None:
            return FIXED.failed_score
        return cause.log_evidence + log_density_of([self.parameter], np.array([width]))


def refine_backlash(
    problem: DiagnosisProblem, base: FittedHypothesis, effect: Effect, enough: float = -np.inf
) -> FittedHypothesis | None:
    """``base`` and backlash; None if nothing is gained, or if the first widths stay under ``enough`` nats."""
    (parameter,), points = grid(effect, problem.model.scale, problem.rules)
    fit, widths = BacklashFit(problem, base, effect, parameter), [width for (width,) in points]
    rules, little = problem.rules.descent, problem.rules.search.min_gain
    least = max(base.log_evidence + little, enough)
    # Where a base leaves nothing, what backlash gains rises with its width: two small ones show whether to try more.
    if base.complete and max(fit.along_base(widths[1:4:2])) < least:
        return None
    gained = fit.along_base(widths)
    if max(gained) < least:
        return None
    # What the narrowest gap explains as well as any, and as the next one, is none of the gap's.
    if max(gained) < gained[0] + little and gained[1] > gained[0] - little:
        return None
    start = float(np.log(widths[int(np.argmax(gained))]))
    for step in (0.0, rules.width_step, -rules.width_step):
        fit.score(start + step)
    if fit.best is None or fit.best.log_evidence < least:
        return None
    top, variance = summit(fit.score, start, problem.rules)
    if not fit.best.complete:
        wider = max((float(np.log(width)) for width in widths if width > rules.wide_backlash), key=fit.score)
        if fit.score(wider) > fit.score(top):
            top, variance = summit(fit.score, wider, problem.rules)
    fit.score(top)
    cause = fit.best
    width = cause.noise[fit.name]
    integral = log_density_of([parameter], np.array([width])) + 0.5 * float(np.log(2 * np.pi * variance))
    noise_log = base.noise_log | {effect.key: integral}
    noise_sd = base.noise_sd | {fit.name: width * float(np.sqrt(variance))}
    evidence, by_size = cause.log_evidence + integral, cause.by_size + integral
    found = replace(cause, log_evidence=evidence, by_size=by_size, noise_log=noise_log, noise_sd=noise_sd)
    if not found.names:
        return found
    settled = refine(problem, found.effects, found.values, found.path, problem.min_size, **found.searched, rounds=3)
    return max(found, settled, key=lambda each: each.log_evidence)


def summit(score: Callable[[float], float], start: float, rules: Rules = DEFAULT) -> tuple[float, float]:
    """Mode of a smooth function of one number, and the variance, at most one, of the Gaussian that it is there."""
    x, h, values = start, rules.descent.width_step, dict[float, float]()

    def at(x: float) -> float:
        if x not in values:
            values[x] = score(x)
        return values[x]

    while True:
        here, left, right = at(x), at(x - h), at(x + h)
        spare = len(values) < rules.descent.max_width_evaluations
        if max(left, right) > here and spare:
            x = x + h if right > left else x - h
            continue
        curvature = max(2 * here - left - right, 1e-9)
        top, variance = x + np.clip(h * (right - left) / (2 * curvature), -h, h), h**2 / curvature
        if curvature < 2 * rules.descent.max_parabola_loss or h < rules.descent.min_width_step or not spare:
            return float(top), float(min(variance, 1.0))
        if abs(top - x) > h / 10 and at(top) > here:
            x = top
        h = float(np.clip(1.5 * np.sqrt(variance), h / 5, h / 2))
