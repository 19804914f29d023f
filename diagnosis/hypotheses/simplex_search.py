"""Parameters that no slope tells of, by a search of their evidence: a grid, a simplex, and the curvature at the top.

Of an effect on the scatter the evidence is that of the data under the changed emission
(:func:`..sensitivity.whiten.whiten` without any column). It is looked at on a grid of quantiles of the prior, and
climbed from the best point on, in logarithms (Nelder & Mead 1965). With H the Hessian of the log density s at the mode
x̂, by differences, the integral is Laplace's:

    log ∫ exp s ≈ s(x̂) + ½ p log 2π − ½ log det(−H).

Shapes: p parameters.
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import ndtri

from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models.effects.base import Effect, Parameter
from invdyn.models.effects.scale import Scale

Score = Callable[[np.ndarray], float]
"""Log evidence plus log prior of the parameters, as logarithms (p,)."""


def grid(effect: Effect, scale: Scale, rules: Rules = DEFAULT) -> tuple[list[Parameter], list[tuple[float, ...]]]:
    """Parameters of a bound effect, and grid points over them, at quantiles of their priors."""
    parameters = list(effect.parameters(scale))
    return parameters, list(product(*(p.grid or _quantiles(p, rules) for p in parameters)))


def _quantiles(parameter: Parameter, rules: Rules) -> tuple[float, ...]:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        draws = parameter.prior.sample((rules.descent.num_prior_draws,)).double()
    return tuple(torch.quantile(draws, torch.tensor(rules.descent.prior_quantiles).double()).tolist())


def log_sd_prior(parameter: Parameter, rules: Rules = DEFAULT) -> float:
    """Standard deviation of a positive parameter's logarithm under its prior, from the quantiles that the grid has."""
    low, *_, high = np.log(_quantiles(parameter, rules))
    first, *_, last = ndtri(rules.descent.prior_quantiles)
    return float((high - low) / (last - first))


def log_density_of(parameters: Sequence[Parameter], values: np.ndarray) -> float:
    """Log prior density of values, in nats, of their logarithms."""
    total = 0.0
    for parameter, value in zip(parameters, values, strict=True):
        total += parameter.prior.log_prob(torch.tensor(float(value))).item() + np.log(value)
    return total


def climb(score: Score, start: np.ndarray, rules: Rules = DEFAULT) -> tuple[np.ndarray, np.ndarray, float]:
    """Mode (p,) of logarithms, their covariance (p, p), and the log-integral of exp(score) around it."""
    first, most = np.vstack([start, start + 0.4 * np.eye(len(start))]), rules.descent.simplex_evaluations * len(start)
    options = {"maxfev": most, "initial_simplex": first, "fatol": 0.1, "xatol": 0.05}
    found = minimize(lambda x: -score(x), start, method="Nelder-Mead", options=options)
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
    # Where the search ended on an edge the curvature is that of an sd of one.
    values, vectors = np.linalg.eigh(-hessian)
    covariance = (vectors / np.maximum(values, 1.0)) @ vectors.T
    integral = top + 0.5 * (p * np.log(2 * np.pi) + np.linalg.slogdet(covariance)[1])
    return x, covariance, integral
