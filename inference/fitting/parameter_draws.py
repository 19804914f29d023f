"""Models and their parameters drawn from their posterior, where several models may have made the rows.

Each model c has free parameters φ, fitted (:mod:`.marginal_likelihood`). All models are as probable before the rows.
Laplace's posterior of each, with the tails of a Student-t of ``DF`` degrees of freedom, is the proposal q, from which
model c gets a share n_c / n of n draws in proportion to its Laplace evidence. Importance weights

    w = p(y | φ, c) p(φ | c) / [C (n_c / n) q(φ | c)],      Ẑ = mean of w over the n draws,

correct it, with the evidence of a model that is linearised once, at the fit, for p(y | φ, c); systematic resampling
leaves sets that weigh the same. A method that estimates p̂(y | φ, c) weighs a set by p̂ times its ``offset``,
log Ẑ − log p(y | φ, c): an importance sampler over models, parameters and paths, whose evidence is that of the mixture,
however near p is to p̂.

A body's numbers that have priors are parameters like any others, so that a recording that tells them a hundred times
better than their priors do has bodies from where they may be. Where only some of a fit's parameters are drawn, the
others stand at what was fitted (:func:`given_the_rest`).

A point fit takes a torque's size and length scale for known, and its bands are too narrow. How many sets it takes
follows from what a state's variance is off by one set, a share s (:attr:`.Fit.scatter` is s², and to it comes what
other models may have made, of probability p, p (1 − p)). Of S sets it is s/√S, and of R draws √(2/R): the first is at
most the second where

    S ≥ ½ R s².

The longer a recording, the better it tells φ: s falls with its length, and one set may do.

Shapes: P parameters, T rows, D states.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np
import torch
from pyro.distributions import Chi2, Distribution, Normal
from torch import Tensor

from invdyn.inference.fitting.log_parameters import Free, LogParameters, M
from invdyn.inference.fitting.marginal_likelihood import Fit
from invdyn.inference.fitting.objective import Objective
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.gaussian import by_root

DF = 8.0
PROPOSALS, MIN_PROPOSALS = 3, 48
"""Draws of the proposal for each set, and in all at least: the evidence is their mean."""


@dataclass(frozen=True)
class Candidate(Generic[M]):
    """A model with the parameters that its fit began at, which of them are free, and the fit.

    Attributes:
        of_more_rows: whether the fit is of other rows as well: draws are then those of its Laplace posterior, which
            is the prior of these rows, and ``fit.log_marginal`` is its evidence.
    """

    model: M
    free: Sequence[Free]
    fit: Fit[M]
    of_more_rows: bool = False


@dataclass(frozen=True)
class ParameterSet(Generic[M]):
    """A model with parameters that were drawn.

    Attributes:
        candidate: number of the candidate that it is of.
        model: with these parameters.
        path: (T, D) about where its most probable path is.
        offset: nats, to add to an estimate of its log-evidence; see the top of the file.
    """

    candidate: int
    model: M
    path: Tensor
    offset: float


def probabilities(candidates: Sequence[Candidate]) -> np.ndarray:
    """Posterior probability (C,) of each candidate, by Laplace's evidence, all as probable before."""
    evidence = np.array([float(each.fit.log_marginal) for each in candidates])
    share = np.exp(evidence - evidence.max())
    return share / share.sum()


def given_the_rest(candidate: Candidate[M], wanted: Callable[[Free], bool]) -> Candidate[M]:
    """The candidate where only ``wanted`` parameters are free, given that all others are as fitted."""
    parameters = _parameters(candidate)
    kept = [f for f in parameters.free if wanted(f)]
    places = [k for f, own in zip(parameters.free, parameters.slices, strict=True) if wanted(f) for k in own]
    others = candidate.fit.phi.copy()
    others[places] = 0.0
    phi, sd = candidate.fit.phi[places], parameters.sd[places]
    covariance = np.linalg.inv(np.linalg.inv(candidate.fit.covariance)[np.ix_(places, places)])
    marginal = candidate.fit.log_evidence
    if not candidate.of_more_rows:
        marginal += 0.5 * np.linalg.slogdet(covariance)[1] - np.log(sd).sum() - 0.5 * ((phi / sd) ** 2).sum()
    found = replace(candidate.fit, phi=phi, covariance=covariance, log_marginal=marginal)
    return replace(candidate, model=parameters.at(torch.as_tensor(others)), free=kept, fit=found)


def sets_needed(candidates: Sequence[Candidate], states: Sequence[int], draws: int) -> int:
    """Sets S for a posterior of so many ``draws``, in which these ``states`` count; see the top of the file."""
    share = probabilities(candidates)
    worst = [each.fit.scatter[list(states)].max() if len(each.fit.scatter) else 1e6 for each in candidates]
    scatter = float(share @ np.minimum(worst, 1e6)) + float((share * (1 - share)).max())
    return max(1, math.ceil(0.5 * draws * scatter))


@torch.no_grad()
def parameter_draws(candidates: Sequence[Candidate[M]], observations: Tensor, count: int) -> list[ParameterSet[M]]:
    """Draw ``count`` sets that weigh the same, in the order of the candidates; by torch's global generator.

    Args:
        candidates: one or more models of the same rows.
        observations: (T, O), NaN where missing.
        count: of sets; one with a large weight may be there several times.
    """
    observations = observations.double()
    share = probabilities(candidates)
    total = max(PROPOSALS * count, MIN_PROPOSALS)
    sizes = np.diff(np.floor(total * np.concatenate([[0.0], share.cumsum()]) + 0.5).astype(int))
    pieces = [_weighed(each, observations, int(size)) for each, size in zip(candidates, sizes, strict=True) if size > 0]
    owners = np.repeat(np.arange(len(candidates)), sizes)
    shares = torch.as_tensor(sizes[owners] / total)
    log_weights = torch.cat([weight for weight, *_ in pieces]) - shares.log()
    log_evidence = torch.cat([evidence for _, evidence, *_ in pieces])
    phi = [row for _, _, piece, _ in pieces for row in piece]
    paths = [path for *_, piece in pieces for path in piece]
    whole = float(log_weights.logsumexp(0)) - math.log(total) - math.log(len(candidates))

    # Systematic: set k is where the running sum of weights passes (k + u) / count.
    places = (torch.arange(count, dtype=torch.float64) + torch.rand((), dtype=torch.float64)) / count
    chosen = torch.searchsorted(log_weights.softmax(0).cumsum(0), places).clamp(max=total - 1)
    found = []
    for k in chosen.tolist():
        candidate = candidates[owners[k]]
        model = _parameters(candidate).at(phi[k])
        found.append(ParameterSet(int(owners[k]), model, paths[k], whole - float(log_evidence[k])))
    return found


def _weighed(candidate: Candidate[M], observations: Tensor, size: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Log of p(y | φ) p(φ) / q(φ), log p(y | φ), both (size,), φ (size, P) and paths (size, T, D) of draws of q.

    Where no draw has a mode, the fitted parameters stand for all.
    """
    found = candidate.fit
    centre = torch.as_tensor(found.phi)
    fitted = (
        torch.full((size,), float(found.log_marginal), dtype=torch.float64),
        torch.full((size,), found.log_evidence, dtype=torch.float64),
        centre.expand(size, -1),
        found.path.expand(size, -1, -1),
    )
    if not len(centre):
        return fitted
    parameters = _parameters(candidate)
    prior: Distribution = Normal(0.0, torch.as_tensor(parameters.sd)).to_event(1)
    root = torch.linalg.cholesky(torch.as_tensor(found.covariance))
    if candidate.of_more_rows:
        prior = by_root(centre, root)
    phi, density = _student_t(centre, root, size)
    objective = Objective(parameters.model, observations, candidate.free, found.path)
    try:
        with diverging():
            evidence, paths = objective.around(found.phi, phi.numpy())
    except Diverged:
        return fitted
    log_evidence = torch.as_tensor(evidence).nan_to_num(-torch.inf, neginf=-torch.inf, posinf=-torch.inf)
    if not bool(torch.isfinite(log_evidence).any()):
        return fitted
    explained = log_evidence
    if candidate.of_more_rows:
        explained = torch.where(log_evidence.isfinite(), found.log_evidence, -torch.inf)
    return explained + prior.log_prob(phi) - density, log_evidence, phi, paths


def _student_t(centre: Tensor, root: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Draws (size, P) of a Student-t of ``DF`` degrees about ``centre`` (P,), of scale ``root`` (P, P), and log q."""
    z = torch.randn(size, len(centre), dtype=centre.dtype)
    z = z * torch.rsqrt(Chi2(torch.tensor(DF, dtype=centre.dtype)).sample((size,)) / DF).unsqueeze(-1)
    whole = 0.5 * (DF + len(centre))
    constant = math.lgamma(whole) - math.lgamma(0.5 * DF) - 0.5 * len(centre) * math.log(DF * math.pi)
    density = constant - root.diagonal().log().sum() - whole * torch.log1p(z.square().sum(-1) / DF)
    return centre + z @ root.mT, density


def _parameters(candidate: Candidate[M]) -> LogParameters[M]:
    return LogParameters(candidate.model.to(dtype=torch.float64), candidate.free)
