"""Effects whose parameters no slope tells of: those on the scatter (:mod:`.noise`), and backlash
(:mod:`.backlash_search`).

The evidence of those on the scatter is first looked at on a grid, along the base's path. What the base has left free is
integrated out at each point. From the best point on, the evidence is climbed along a path of its own. Its curvature at
the top is their integral's width (Laplace).

Several of them take each other's part: noise that grows with speed has many outliers until those are counted
too, and with them it hardly grows. So each is searched again with the others, from its grid on, in
turns, until none gains (coordinate ascent).
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import cycle, islice

import numpy as np
import torch
from scipy.special import logsumexp
from torch import Tensor

from invdyn.diagnosis.hypotheses.backlash_search import refine_backlash
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.simplex_search import climb, grid, log_density_of
from invdyn.diagnosis.kept_units import kept_unit
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_noise
from invdyn.diagnosis.problem.unknowns import bounds, unknowns
from invdyn.diagnosis.sensitivity.memory import expansions
from invdyn.diagnosis.sensitivity.sensitivities import slopes
from invdyn.diagnosis.sensitivity.whiten import filter_of, linear_of, whiten
from invdyn.inference.smoothing.linearisation import Linearisation, Slopes, seen_as, seen_rows, slopes_along
from invdyn.models.effects.base import Effect


@kept_unit("search", FittedHypothesis)
def refine_searched(
    problem: DiagnosisProblem, base: FittedHypothesis, effect: Effect, enough: float = -np.inf
) -> FittedHypothesis | None:
    """``base`` and an effect whose parameters are searched.

    None if nothing is gained, or if the best of a grid stays under ``enough`` nats.
    """
    if not is_noise(effect):
        return refine_backlash(problem, base, effect, enough)
    best = _added(problem, base, effect, max(base.log_evidence + problem.rules.search.min_gain, enough))
    if best is None or best.log_evidence < base.log_evidence + problem.rules.descent.min_repeat_gain:
        return best
    turns = [*(each for each in base.effects if is_noise(each)), effect]
    last = effect
    for each in islice(cycle(turns), problem.rules.descent.max_searches * len(turns)):
        if each is last:
            break  # every other one has had its turn since
        again = _added(problem, best.less(problem, each), each, -np.inf, best.noise)
        if again is not None and again.log_evidence > best.log_evidence + problem.rules.search.min_gain:
            best, last = again, each
    return best


def _added(
    problem: DiagnosisProblem,
    base: FittedHypothesis,
    effect: Effect,
    least: float,
    values: Mapping[str, float] | None = None,
) -> FittedHypothesis | None:
    """``base`` and an effect on the scatter, from the best point of its grid or, where there are any, its ``values``.

    None if that stays under ``least`` nats.
    """
    parameters, points = grid(effect, problem.model.scale, problem.rules)
    names = [f"{effect.key}.{p.name}" for p in parameters]
    if values is not None:
        points = [*points, tuple(values[name] for name in names)]
    common, levels = unknowns(problem, base.effects), problem.regime.sizes
    columns = slopes(base.model, common, base.mean, problem.rules.screening.slope_step * base.sd, base.path)
    model, some = base.model.with_effects(effect), _telling(base, levels)

    def along(cause: FittedHypothesis) -> tuple[Tensor, Slopes, Linearisation]:
        """Path, slopes and linearisation: what changes the scatter alone leaves them."""
        tangents = slopes_along(cause.model, cause.path)
        return cause.path, tangents, linear_of(problem, cause.model, cause.path, tangents)

    path, tangents, moving = along(base)
    most = np.array([bounds(p, problem.rules)[1] for p in parameters])

    def by_size(values: np.ndarray) -> np.ndarray:
        """Log evidence with ``some`` sizes of the residual, and their prior weights."""
        given = {f"effect.{n}": torch.tensor([v], dtype=torch.float64) for n, v in zip(names, values, strict=True)}
        here = model.replace(**given)
        linear = seen_as(moving, seen_rows(here, path, problem.observations), tangents[1])
        whitened = whiten(problem, filter_of(problem, here, path, levels[some], linear), columns)
        found = [outcome.log_evidence for outcome in expansions(whitened, common, base.mean, problem.rules)]
        return np.array(found) + problem.regime.log_prior[some]

    def score(log_values: np.ndarray) -> float:
        values = np.minimum(np.exp(log_values), most)
        return float(logsumexp(by_size(values))) + log_density_of(parameters, values)

    gained = [(float(logsumexp(by_size(np.array(point)))), point) for point in points]
    top, start = max(gained)
    if top < least - sum(base.noise_log.values()):
        return None
    # A larger residual than there is bends the path, and under a smaller one than it takes Gauss–Newton may rather call
    # most detections outliers; a limb's own torque is as large as it was found.
    size = problem.min_size if problem.regime.knows_torque else float(levels[base.by_size.argmax()])
    some = np.arange(len(levels))
    size = max(size, float(levels[by_size(np.array(start)).argmax()]))
    first = np.log(start)
    values = base.values | dict(zip(names, np.exp(first).tolist(), strict=True))
    cause = refine(problem, (*base.effects, effect), values, path, size, rounds=2)
    (path, tangents, moving), some = along(cause), _telling(cause, levels)
    climbed, covariance, integral = climb(score, first, problem.rules)
    climbed = np.minimum(climbed, np.log(most))
    own = integral - float(logsumexp(by_size(np.exp(climbed))))
    noise_log = base.noise_log | {effect.key: own}
    values = base.values | dict(zip(names, np.exp(climbed).tolist(), strict=True))
    cause = refine(problem, (*base.effects, effect), values, path, size, noise_log=noise_log, rounds=3)
    sds = np.exp(climbed) * np.sqrt(np.diag(covariance))
    return replace(cause, noise_sd=base.noise_sd | dict(zip(names, sds.tolist(), strict=True)))


def _telling(cause: FittedHypothesis, levels: np.ndarray) -> np.ndarray:
    """Numbers of the sizes that matter to a cause: its best and their neighbours, and the spike."""
    best = int(cause.by_size.argmax())
    return np.unique(np.clip([0, best - 1, best, best + 1], 0, len(levels) - 1))
