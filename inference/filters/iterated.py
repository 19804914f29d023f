"""Refit the controlled guide's factors on its own particles.

Guarniero, Johansen & Lee (2017), "The iterated auxiliary particle filter"; Heng, Bishop,
Deligiannidis & Doucet (2020), "Controlled sequential Monte Carlo", algorithm 3 (approximate dynamic
programming). The best ψ_t, whose filter has no variance at all, satisfies

    log ψ_t(x) = V_t(x) = log g(y_t | x) + log ∫ N(x'; f(x), Q) ψ_{t+1}(x') dx',

with an integral in closed form for a Gaussian ψ_{t+1} and the exact f. A linearised model's ψ_t
solves it for its own f and g only, and its tails are too light where the posterior bends: now and
then one filter finds what is missed there and outweighs all others. So, backwards in time, the
difference to the factor so far is regressed on the particles of pilot runs, whitened by
z = S⁻¹ (x − m):

    V_t − log ψ_t ≈ c + lᵀz + ½ zᵀH z         least squares with a small ridge towards no change,

and added to it; precisions stay positive by a floor. The particles that it is fitted on are drawn
half evenly and half by their weight over all filters, so that a region which only one filter has
found counts by its posterior mass. For a linear-Gaussian model V_t = log ψ_t, and nothing changes.

The evidence stays unbiased: the factors come from pilot runs, and the filters that use them
afterwards draw fresh random numbers.

Shapes: T rows, D states, n points; numpy float64 for any type of the filters.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.contract import in_float64
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.nested import outer_weights
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.second_opinion import Evidence, evidence, exceeds
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.posterior_linearisation import fit_linear, recentred_on_mean
from invdyn.inference.smoothing.square_root import conditional, eliminate, log_abs_det
from invdyn.models.divergence import Singular, diverging
from invdyn.models.observation.missing import observed_log_prob
from invdyn.models.state_space import StateSpaceModel, gaussian_mean

RIDGE = 1e-3
FLOOR = 1e-4  # of a refitted precision, in units of the particles' own: flat, but finite in float32
EXACT = 1e-6  # nats: a smaller correction is rounding


LINES, RISE = 16, 0.5
"""Ancestral lines of each filter; nats under which a pilot is not higher than the one before."""
STEADY = 0.05
"""Standard deviation of log Ẑ, nats, that no refit need improve: the outer sampler then has 99.8 % of its filters."""


def iterate(
    model: StateSpaceModel,
    observations: Tensor,
    smoothers: Sequence[GaussianSmoother],
    pilot: Callable[[GaussianSmoother], FilterResult],
    *,
    iterations: int = 2,
    num_points: int = 3000,
    results: Sequence[FilterResult] = (),
) -> tuple[GaussianSmoother, Tensor]:
    """Return the smoother whose factors guide the steadiest filters, its factors refitted to the model.

    Smoothers whose pilot run leaves a log Ẑ that is lower beyond errors are passed over: their filters miss a part of
    the posterior, and agree on it. Of the others the one with the smallest sd of log Ẑ over filters is, unless that is
    next to nothing, refitted ``iterations`` times, on the particles of all pilot runs so far. The last refit is kept
    unless its own pilot is less steady, or lower, than that of the smoother it started from. Random numbers are
    torch's own (global seed).

    Args:
        model: with Gaussian transition noise whose covariance does not depend on the state.
        observations: (T, O), NaN where missing.
        smoothers: to start from, unbatched: Gauss–Newton's and posterior linearisations'.
        pilot: runs at least two filters, guided by a smoother's factors, and keeps all rows.
        iterations: refits; each costs a pilot run and about twice as much again.
        num_points: n, particles of a row that a fit uses.
        results: of other filters that kept all rows, whose particles count too.

    Returns the smoother and the log-evidences (M,) of its pilot run.

    Raises SMCFailed when the pilots of all smoothers fail, ValueError without a smoother.
    """
    runs = _piloted(smoothers, pilot)
    start, first = min(_not_lower(runs), key=lambda run: _filter_sd(run[1]))
    if _filter_sd(first) < STEADY:
        return start, first.log_evidence
    results = [*results, *(result for _, result in runs)]
    latest = start
    for _ in range(iterations):
        try:
            # A few particles far from the others can make the backward sweep diverge.
            with np.errstate(over="raise", invalid="raise"), diverging():
                latest = refit(model, observations, latest, results, num_points)
            results.append(pilot(latest))
        except (SMCFailed, FloatingPointError, Singular):
            return start, first.log_evidence
    # Not the smallest sd of all refits: a run that has missed a region looks the steadiest.
    if _filter_sd(results[-1]) <= _filter_sd(first) and not exceeds(_found(first), _found(results[-1])):
        return latest, results[-1].log_evidence
    return start, first.log_evidence


def refitted_over_paths(
    model: StateSpaceModel,
    observations: Tensor,
    smoothers: Sequence[GaussianSmoother],
    pilot: Callable[[GaussianSmoother], FilterResult],
    iterations: int,
) -> tuple[GaussianSmoother, Tensor]:
    """As :func:`iterate`, of a model with kinks: across one a quadratic in V_t fits worse than the smoother's.

    So the model is linearised again over the Gaussian of the paths that a pilot found, of which half count evenly and
    half by their filters' weight, and half of whose covariance is the smoother's. Passes of a smoother alone settle on
    one side of a kink. Of all pilots that none exceeds, the steadiest one's smoother is taken.
    """
    runs = _piloted(smoothers, pilot)
    smoother, result = min(_not_lower(runs), key=lambda run: _filter_sd(run[1]))
    model, rows = in_float64(model, observations)
    for _ in range(3 * iterations):
        before = _found(result).log_evidence
        paths = genealogy(result, LINES).cpu().double()
        weight = 0.5 * result.log_evidence.cpu().double().softmax(0) + 0.5 / len(paths)
        mean = torch.einsum("m,mrtd->td", weight / LINES, paths)
        off = paths - mean
        covariance = torch.einsum("m,mrtd,mrte->tde", weight / LINES, off, off)
        try:
            with diverging():
                linear = fit_linear(model, rows, mean, (covariance + smoother.covariance()) / 2)
                smoother = recentred_on_mean(model, rows, mean, linear, smoother.converged)
            result = pilot(smoother)
        except (SMCFailed, Singular):
            break
        runs.append((smoother, result))
        if _found(result).log_evidence < before + RISE:
            break
    smoother, result = min(_not_lower(runs), key=lambda run: _filter_sd(run[1]))
    return smoother, result.log_evidence


Run = tuple[GaussianSmoother, FilterResult]


def _piloted(smoothers: Sequence[GaussianSmoother], pilot: Callable[[GaussianSmoother], FilterResult]) -> list[Run]:
    """Pilots of the smoothers, of those whose do not fail; raises as :func:`iterate`."""
    runs: list[Run] = []
    failure: Exception = ValueError("expected at least one smoother to start from, got none")
    for smoother in smoothers:
        try:
            runs.append((smoother, pilot(smoother)))
        except SMCFailed as error:
            failure = error
    if not runs:
        raise failure
    return runs


def _not_lower(runs: Sequence[Run]) -> Sequence[Run]:
    """Those pilot runs that the highest evidence of all does not exceed."""
    highest = max(runs, key=lambda run: _found(run[1]).log_evidence)
    return [run for run in runs if run is highest or not exceeds(_found(highest[1]), _found(run[1]))]


def _found(result: FilterResult) -> Evidence:
    return evidence(result.log_evidence, "controlled")


def _filter_sd(result: FilterResult) -> float:
    return outer_weights(result.log_evidence).filter_sd


@torch.no_grad()
def refit(
    model: StateSpaceModel,
    observations: Tensor,
    smoother: GaussianSmoother,
    results: Sequence[FilterResult],
    num_points: int = 3000,
) -> GaussianSmoother:
    """One backward sweep over the particles of ``results``, runs of the same model that kept all rows."""
    model, observations = in_float64(model, observations)
    path, old = smoother.path, smoother.factors
    steps = len(path)
    U, b, log_c = old.U.copy(), old.b.copy(), old.log_c.copy()
    A, alpha, log_n = old.A.copy(), old.alpha.copy(), old.log_n.copy()
    R, B, r = np.empty_like(U), np.empty_like(U), np.empty_like(b)
    for t in range(steps - 1, -1, -1):
        state = _points(results, t, num_points)
        value = np.zeros(len(state))
        if bool((~torch.isnan(observations[t])).any()):
            value += observed_log_prob(model.emission(state, t), observations[t]).numpy()
        if t + 1 < steps:
            prediction = (gaussian_mean(model.transition(state, t + 1)) - path[t + 1]).numpy()
            value += _log_factor(prediction, A[t + 1], alpha[t + 1], log_n[t + 1])
        U[t], b[t], log_c[t] = _corrected(U[t], b[t], log_c[t], (state - path[t]).numpy(), value)
        R[t], B[t], r[t], A[t], alpha[t] = eliminate(U[t], b[t], smoother.linearisation.L[t])
        log_n[t] = log_c[t] - log_abs_det(R[t])
    gain, offset, root = conditional(R, B, r, smoother.linearisation.L)
    log_evidence = _log_factor(smoother.linearisation.m0[None], A[0], alpha[0], log_n[0])[0]
    factors = replace(
        old,
        **{"U": U, "b": b, "log_c": log_c, "A": A, "alpha": alpha, "log_n": log_n},
        **{"gain": gain, "offset": offset, "root": root, "log_evidence": log_evidence},
    )
    return replace(smoother, factors=factors)


def _points(results: Sequence[FilterResult], t: int, num_points: int) -> Tensor:
    """States (n, D) of row ``t``: half drawn evenly from all filters, half by weight."""
    states = torch.cat([result.states[t].flatten(0, 1) for result in results]).cpu().double()
    # Every Ẑ estimates the same evidence, so particles of all runs share one scale of weights.
    log_weights = [result.log_weights[t] + result.log_evidence.unsqueeze(-1) for result in results]
    weights = torch.cat([values.flatten() for values in log_weights]).cpu().double().softmax(0)
    mixed = 0.5 * weights + 0.5 / len(weights)
    return states[torch.multinomial(mixed, num_points, replacement=True)]


def _log_factor(x: np.ndarray, U: np.ndarray, b: np.ndarray, log_c: float) -> np.ndarray:
    return log_c - 0.5 * ((x @ U.T - b) ** 2).sum(-1)


def _corrected(
    U: np.ndarray, b: np.ndarray, log_c: float, x: np.ndarray, value: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """U, b, log_c of the factor that fits ``value`` (n,) at points ``x`` (n, D), given the factor so far."""
    count, dim = x.shape
    mean = x.mean(0)
    deviation = x - mean
    # A small share of each coordinate's own sd keeps S regular when points lie in a plane.
    sliver = 1e-6 * np.diag(np.maximum(deviation.std(0), 1e-12))
    S = np.asarray(np.linalg.qr(np.concatenate([deviation / np.sqrt(count), sliver]), mode="r")).T
    z = np.linalg.solve(S, deviation.T).T
    # Hermite polynomials are orthonormal on a Gaussian cloud, so one ridge fits all coefficients.
    row, column = np.triu_indices(dim)
    square = row == column
    scale = np.where(square, np.sqrt(2.0), 1.0)
    features = np.concatenate([np.ones((count, 1)), z, (z[:, row] * z[:, column] - square) / scale], 1)
    penalty = RIDGE * count * np.eye(features.shape[1])
    penalty[0, 0] = 0.0
    difference = value - _log_factor(x, U, b, log_c)
    fit = np.linalg.solve(features.T @ features + penalty, features.T @ difference)
    log_c = log_c + fit[0]
    if np.abs(fit[1:]).max() < EXACT:
        return U, b, log_c
    linear, quadratic = fit[1 : 1 + dim], fit[1 + dim :] / scale
    log_c -= quadratic[square].sum()
    H = np.zeros((dim, dim))
    H[row, column] = quadratic
    H = H + H.T

    # In z: log ψ = log_c − ½|u z − v|² + lᵀz + ½ zᵀH z = const + (uᵀv + l)ᵀz − ½ zᵀ(uᵀu − H) z
    u, v = U @ S, b - U @ mean
    precision, basis = np.linalg.eigh(u.T @ u - H)
    root = np.sqrt(np.maximum(precision, FLOOR))
    target = basis.T @ (u.T @ v + linear) / root
    log_c += 0.5 * (target @ target - v @ v)
    U = np.linalg.solve(S.T, basis * root).T
    return U, target + U @ mean, log_c
