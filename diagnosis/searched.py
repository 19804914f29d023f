"""Effects whose parameters no slope tells of: those on the scatter (:mod:`.noise`), and play.

Their evidence is looked at on a grid, with what the base has left free integrated out at each point; from the best
point on it is climbed, and its curvature at the top is their integral's width (Laplace). That is along one path, and
play's gap bends it: its width is followed, a step and a path at a time, before it is climbed. Where that leaves
something, each of the widest gets a path that is led to it (:func:`.paths.led`); the best is followed so, if better.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np
import torch
from scipy.special import logsumexp
from torch import Tensor

from invdyn.diagnosis.candidates import slopes
from invdyn.diagnosis.cause import Refined
from invdyn.diagnosis.noise import climb, grid, is_noise, log_prior_of
from invdyn.diagnosis.paths import FIRM, led, lifted
from invdyn.diagnosis.promising import attempt
from invdyn.diagnosis.refine import expansions, refine
from invdyn.diagnosis.setting import Setting
from invdyn.diagnosis.unknowns import unknowns, upper_bound
from invdyn.diagnosis.whiten import filter_of, linear_of, log_prior, sizes, whiten
from invdyn.inference.gauss_newton import slopes_along
from invdyn.models.effects.base import Effect

EARNED = 2.0
"""Nats that an effect whose parameters are searched must gain over its base on the grid, to be searched further."""
FOLLOWED, STRIDES, ONWARD = 20.0, (0.15, 0.07, 0.035), 0.5
"""Nats that play must gain for its width to be followed; steps of its logarithm, one after the other, and nats that
each must gain."""
WIDER = 0.1
"""rad, of play that bends a path by so much that it may need to be led there."""


def refine_searched(setting: Setting, base: Refined, effect: Effect, enough: float = -np.inf) -> Refined | None:
    """``base`` and an effect whose parameters are searched: on the scatter (:mod:`.noise`), or play.

    None if nothing is gained, or if the best of a grid stays under ``enough`` nats.
    """
    parameters, points = grid(effect, setting.model.scale)
    names = [f"{effect.key}.{p.name}" for p in parameters]
    known = dict(zip(base.names, base.mean.tolist(), strict=True)) | base.noise
    model = base.model.with_effects(effect)
    levels = sizes(setting.regime)
    common = unknowns(setting, base.effects)
    columns = slopes(base.model, common, base.mean, 0.05 * base.sd, base.path)
    path, some = base.path, _telling(base, levels)

    # What changes the scatter alone leaves the slopes as they are, whatever its parameters.
    tangents = slopes_along(base.model, path) if is_noise(effect) else None

    most = np.array([upper_bound(p) for p in parameters])

    def by_size(values: np.ndarray) -> np.ndarray:
        """Log evidence with ``some`` sizes of the residual, and their prior weights."""
        given = {f"effect.{n}": torch.tensor([v], dtype=torch.float64) for n, v in zip(names, values, strict=True)}
        here, there, those = model.replace(**given), path, columns
        if model.driven is not None:
            there = lifted(here, path)
            those = slopes(here, common, base.mean, 0.05 * base.sd, there)
        linear = linear_of(setting, here, there, tangents)
        whitened = whiten(setting, filter_of(setting, here, there, levels[some], linear), those)
        return np.array([o.log_evidence[0] for o in expansions(whitened, common, base.mean)]) + log_prior(levels)[some]

    def score(log_values: np.ndarray) -> float:
        values = np.minimum(np.exp(log_values), most)
        return float(logsumexp(by_size(values))) + log_prior_of(parameters, values)

    def best_of(points: list[tuple[float, ...]]) -> tuple[float, tuple[float, ...]]:
        return max((score(np.log(point)) - log_prior_of(parameters, np.array(point)), point) for point in points)

    least = max(base.log_evidence + EARNED, enough) - base.noise_log
    # Where a base leaves nothing, what play gains rises with its width: two small ones tell whether to look for more.
    if model.driven is not None and base.complete and best_of(points[1:4:2])[0] < least:
        return None
    top, start = best_of(points)
    if top < least:
        return None
    # A larger residual than there is bends the path, and under a smaller one than it takes Gauss–Newton may rather call
    # most detections stray; a limb's own torque is as large as it was found.
    size = float(levels[base.by_size.argmax()]) if setting.regime == "unknown_torque" else FIRM
    if tangents is not None:
        some = np.arange(len(levels))
        size = max(size, float(levels[by_size(np.array(start)).argmax()]))
    start = np.log(start)
    values = known | dict(zip(names, np.exp(start).tolist(), strict=True))
    cause = refine(setting, (*base.effects, effect), values, path, size, rounds=2)
    if model.driven is not None and cause.log_evidence > max(enough, base.log_evidence + FOLLOWED):
        limits = dict(zip(names, most.tolist(), strict=True))
        cause = _followed(setting, cause, limits)
        if not cause.complete:
            wider = [known | dict(zip(names, point, strict=True)) for point in points if min(point) > WIDER]
            tried = [attempt(_at, setting, cause, each, base.path, 1) for each in wider]
            best = max([cause, *(c for c in tried if c is not None)], key=lambda c: c.log_evidence)
            if best is not cause:
                cause = attempt(_followed, setting, best, limits, base.path) or best
        start = np.log([cause.noise[name] for name in names])
    followed = cause
    path, some = cause.path, _telling(cause, levels)
    tangents = slopes_along(cause.model, path) if is_noise(effect) else None
    start, covariance, integral = climb(score, start)
    start = np.minimum(start, np.log(most))
    noise_log = base.noise_log + integral - (score(start) - log_prior_of(parameters, np.exp(start)))
    values = known | dict(zip(names, np.exp(start).tolist(), strict=True))
    cause = refine(setting, (*base.effects, effect), values, path, size, noise_log=noise_log, rounds=3)
    if model.driven is not None and cause.log_evidence < followed.log_evidence + noise_log:
        # Along the path it was climbed to somewhere else, and there it is not as good.
        start = np.log([followed.noise[name] for name in names])
        evidence, by_size = followed.log_evidence + noise_log, followed.by_size + noise_log
        cause = replace(followed, noise_log=noise_log, log_evidence=evidence, by_size=by_size)
    spreads = np.exp(start) * np.sqrt(np.diag(covariance))
    return replace(cause, noise_sd=base.noise_sd | dict(zip(names, spreads.tolist(), strict=True)))


def _followed(setting: Setting, cause: Refined, most: Mapping[str, float], begun: Tensor | None = None) -> Refined:
    """The cause with other values of parameters, up to ``most``, each refined from the last path while that gains.

    Or, where one is given, from the path that is led to them from ``begun``.
    """
    for stride, name in product(STRIDES, most):
        for step in (stride, -stride):
            before = cause
            while True:
                values = cause.values | {name: min(cause.noise[name] * float(np.exp(step)), most[name])}
                there = _at(setting, cause, values, begun, 2)
                if there.log_evidence < cause.log_evidence + ONWARD:
                    break
                cause = there
            if cause is not before:
                break
    return cause


def _at(setting: Setting, cause: Refined, values: Mapping[str, float], begun: Tensor | None, rounds: int) -> Refined:
    """The cause refined from other values, from its own path or from one that is led to them from ``begun``."""
    path = cause.path
    if begun is not None:
        given = {f"effect.{n}": torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
        model = cause.model.replace(**{name: v for name, v in given.items() if name in cause.model.parameters})
        path = led(setting, model, lifted(model, begun), FIRM)
    return refine(setting, cause.effects, values, path, FIRM, noise_log=cause.noise_log, rounds=rounds)


def _telling(cause: Refined, levels: np.ndarray) -> np.ndarray:
    """Numbers of the sizes that matter to a cause: its best and their neighbours, and the spike."""
    best = int(cause.by_size.argmax())
    return np.unique(np.clip([0, best - 1, best, best + 1], 0, len(levels) - 1))
