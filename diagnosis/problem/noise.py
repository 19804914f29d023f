"""Effects that no column describes, so that their few parameters are searched: those on the scatter, and play.

Stray detections, exchanged labels, mistimed frames and noise that grows with speed change what an observation may
be, not where it is expected. Their evidence is that of the data under the changed emission (:func:`.whiten.whiten`
without any column), on a grid of their parameters first, and then by a simplex search of the logarithms from the
best one on. The posterior's spread comes from the curvature there. Play is searched too (:mod:`.backlash_search`).
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import ndtri

from invdyn.models.effects.base import Effect, Parameter
from invdyn.models.effects.hidden import HiddenHinge
from invdyn.models.effects.scale import Scale

EVALUATIONS = 16
QUANTILES = (0.1, 0.3, 0.6, 0.9)
DRAWS = 2000

Score = Callable[[np.ndarray], float]
"""Log evidence plus log prior of the parameters, as logarithms (p,)."""


def is_noise(effect: Effect) -> bool:
    """Whether an effect changes the scatter of what is seen and not its mean."""
    return type(effect).noise is not Effect.noise or is_mistake(type(effect))


def is_mistake(kind: type[Effect]) -> bool:
    """Whether effects of a kind make rows a mixture: of what the tracker may have got wrong."""
    return kind.mistake is not Effect.mistake


def is_searched(effect: Effect) -> bool:
    """Whether the parameters of an effect are searched, because no column describes what they change."""
    return is_noise(effect) or (isinstance(effect, HiddenHinge) and effect.forgets)


def grid(effect: Effect, scale: Scale) -> tuple[list[Parameter], list[tuple[float, ...]]]:
    """Parameters of a bound effect, and grid points over them, spread as their priors are."""
    parameters = list(effect.parameters(scale))
    return parameters, list(product(*(p.grid or _quantiles(p) for p in parameters)))


def _quantiles(parameter: Parameter) -> tuple[float, ...]:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        draws = parameter.prior.sample((DRAWS,)).double()
    return tuple(torch.quantile(draws, torch.tensor(QUANTILES).double()).tolist())


def log_spread(parameter: Parameter) -> float:
    """Standard deviation of a positive parameter's logarithm under its prior, from the quantiles that the grid has."""
    low, *_, high = np.log(_quantiles(parameter))
    return float((high - low) / (ndtri(QUANTILES[-1]) - ndtri(QUANTILES[0])))


def log_prior_of(parameters: Sequence[Parameter], values: np.ndarray) -> float:
    """Log prior density of values, in nats, of their logarithms."""
    total = 0.0
    for parameter, value in zip(parameters, values, strict=True):
        total += parameter.prior.log_prob(torch.tensor(float(value))).item() + np.log(value)
    return total


def climb(score: Score, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Mode (p,) of logarithms, their covariance (p, p), and the log-integral of exp(score) around it."""
    found = minimize(
        lambda x: -score(x),
        start,
        method="Nelder-Mead",
        options={"maxfev": EVALUATIONS * len(start), "initial_simplex": _simplex(start), "fatol": 0.1, "xatol": 0.05},
    )
    x, top = found.x, -found.fun
    p, step = len(x), 0.1
    unit = step * np.eye(p)
    hessian = np.empty((p, p))
    singles = np.array([[score(x + unit[i]), score(x - unit[i])] for i in range(p)])
    for i in range(p):
        hessian[i, i] = (singles[i].sum() - 2 * top) / step**2
        for j in range(i):
            both = score(x + unit[i] + unit[j])
            hessian[i, j] = hessian[j, i] = (both - singles[i, 0] - singles[j, 0] + top) / step**2
    # Where the search ended on an edge the curvature is what a spread of one would give.
    values, vectors = np.linalg.eigh(-hessian)
    covariance = (vectors / np.maximum(values, 1.0)) @ vectors.T
    integral = top + 0.5 * (p * np.log(2 * np.pi) + np.linalg.slogdet(covariance)[1])
    return x, covariance, integral


def _simplex(start: np.ndarray) -> np.ndarray:
    return np.vstack([start, start + 0.4 * np.eye(len(start))])
