"""An effect of a refined cause in the words of the result: place, and parameters with units and intervals.

Intervals are those of a coarsened posterior (:mod:`.prior`), the likelihood raised to ζ, by a larger α than between
causes: where much was gained, what reality's effect is otherwise than the catalogue's moves parameters by more than
noise does. With the refined precision Λ and the prior's S⁻¹,

    Λ_ζ = ζ (Λ − S⁻¹) + S⁻¹
"""

from collections.abc import Mapping

import numpy as np
import torch

from invdyn.diagnosis.assessment.result import Change, Estimate, Finding, Learned
from invdyn.diagnosis.catalogue import CATALOGUE, CatalogueEntry
from invdyn.diagnosis.hypotheses.simplex_search import log_sd_prior
from invdyn.diagnosis.problem.cause import FittedHypothesis, of_effect
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import bounds, unknowns
from invdyn.models.effects.base import Effect, Parameter, Scale, side_of


def place(effect: Effect) -> dict[str, str]:
    """Where an effect acts, "joint", "link" or "keypoint" → name, "partner" for pairs, "stop" for limits, "form"."""
    names, form = (list(effect.where), {}) if effect.form is None else (list(effect.where[:-1]), {"form": effect.form})
    if effect.site == "stop":
        return {"joint": names[0], "stop": names[1]}
    if effect.site == "pair":  # the torque acts on the outer one
        return {"joint": names[1], "partner": names[0]}
    if effect.site == "keypoints":
        return {"keypoint": names[0], "partner": names[1]}
    if not names:
        return form
    return {"joint" if effect.site == "arm" else effect.site: names[0], **form}


def key(effect: Effect) -> str:
    """Effect and place as :attr:`.Finding.key` has it."""
    return ".".join([effect.name, *place(effect).values()])


def finding(
    problem: DiagnosisProblem, cause: FittedHypothesis, effect: Effect, seed: int, temper: float = 1.0
) -> Finding:
    """Posterior of one effect's parameters, by draws from the refined Gaussian within the bounds; ``temper`` is ζ."""
    parameters, entry = effect.parameters(problem.model.scale), problem.catalogue.of(effect)
    whole = drawn(problem, cause, seed, temper)
    draws = _draws(problem, cause, effect, whole, seed, temper)
    described = described_by(entry, effect, draws, problem.model.scale)
    if any(p.located for p in parameters):  # in the recording's times
        described |= {n: (described[n][0] + problem.problem.origin, "s") for n in ("start", "stop") if n in described}
    narrowed = of_effect(effect, _narrowed(problem, cause, temper))
    # Of what was searched, where the search ended: the mean of wide draws of a logarithm lies far above it.
    return finding_of(problem, effect, described, of_effect(effect, cause.noise), narrowed, whole)


def finding_of(
    problem: DiagnosisProblem,
    effect: Effect,
    described: Mapping[str, tuple[np.ndarray, str]],
    means: Mapping[str, float],
    narrowed: Mapping[str, float] = {},
    others: Mapping[str, np.ndarray] = {},
) -> Finding:
    """An effect by draws (N,) of each number that is reported of it, with its unit, and what those add to the file.

    Of some numbers `means` has the mean, and `narrowed` the sd as a share of the prior's. `others` are draws of the
    cause's unknowns, "body.damping.0": numbers of the file that are uncertain, too.
    """
    estimates = {
        name: estimate(values, unit, narrowed.get(name, float("nan")), means.get(name))
        for name, (values, unit) in described.items()
    }
    changes, entry = {}, problem.catalogue.of(effect)
    for name, quantity in entry.body_file_fields.items():
        if name in estimates and (before := problem.model.scale.filed(quantity, effect.place[0])):
            e, own = estimates[name], others.get(f"body.{quantity}.{effect.place[0]}")
            mean = before + e.mean if own is None else None
            after = estimate((before if own is None else own) + e.draws, e.unit, e.narrowed, mean)
            changes[name] = Change(before, after)
    known = CATALOGUE.get(effect.name) is entry
    return Finding(effect.name, side_of(effect), place(effect), estimates, changes, None if known else entry)


def described_by(
    entry: CatalogueEntry, effect: Effect, draws: dict[str, np.ndarray], scale: Scale
) -> dict[str, tuple[np.ndarray, str]]:
    """Draws (N,) and unit of each number that is reported of an effect, from ``draws`` of its parameters."""
    reported = entry.reported(effect, {name: torch.as_tensor(values)[:, None] for name, values in draws.items()})
    own = {p.name: (draws[p.name], p.unit) for p in effect.parameters(scale)}
    return {name: (values.reshape(-1).numpy(), unit) for name, (values, unit) in reported.items()} or own


def learned(problem: DiagnosisProblem, cause: FittedHypothesis, seed: int, temper: float = 1.0) -> tuple[Learned, ...]:
    """The body's uncertain numbers as a cause has them."""
    found = []
    values = drawn(problem, cause, seed, temper) if problem.uncertain else {}
    narrowed = _narrowed(problem, cause, temper) if problem.uncertain else {}
    for number in problem.uncertain:
        after = estimate(values[number.name], number.unit, narrowed[number.name])
        found.append(Learned(number.place, number.what, Change(number.mean, after)))
    return tuple(found)


def estimate(values: np.ndarray, unit: str, narrowed: float, mean: float | None = None) -> Estimate:
    """Of draws (N,), and their ``mean`` where it is known."""
    low, high = np.quantile(values, [0.05, 0.95])
    mean = float(values.mean() if mean is None else mean)
    return Estimate(mean, float(values.std()), (float(low), float(high)), unit, values, narrowed)


def _narrowed(problem: DiagnosisProblem, cause: FittedHypothesis, temper: float) -> dict[str, float]:
    """Sd of each of a cause's unknowns as a share of its prior's."""
    among = unknowns(problem, cause.effects)
    if not among.names:
        return {}
    sd = np.sqrt(np.diag(tempered_covariance(cause.covariance, among.sd, temper)))
    return dict(zip(among.names, (sd / among.sd).tolist(), strict=True))


def drawn(problem: DiagnosisProblem, cause: FittedHypothesis, seed: int, temper: float) -> dict[str, np.ndarray]:
    """Draws (N,) of all of a cause's unknowns by name, from the refined Gaussian within the bounds."""
    among, rng = unknowns(problem, cause.effects), np.random.default_rng(seed)
    if not among.names:
        return {}
    covariance = tempered_covariance(cause.covariance, among.sd, temper)
    count = problem.rules.outcome.num_interval_draws
    values = rng.multivariate_normal(cause.mean, covariance, count, method="eigh")
    return dict(zip(among.names, np.clip(values, among.lower, among.upper).T, strict=True))


def _draws(
    problem: DiagnosisProblem,
    cause: FittedHypothesis,
    effect: Effect,
    whole: dict[str, np.ndarray],
    seed: int,
    temper: float,
) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    names = [f"{effect.key}.{p.name}" for p in effect.parameters(problem.model.scale)]
    if is_searched(effect):
        parameters = effect.parameters(problem.model.scale)
        return {p.name: _searched(problem, cause, p, temper, rng, f"{effect.key}.{p.name}") for p in parameters}
    return {name.rsplit(".", 1)[1]: whole[name] for name in names}


def _searched(
    problem: DiagnosisProblem,
    cause: FittedHypothesis,
    p: Parameter,
    temper: float,
    rng: np.random.Generator,
    name: str,
) -> np.ndarray:
    """Draws (N,) of a parameter that was searched, Gaussian in its logarithm as the search has it."""
    value, prior = cause.noise[name], log_sd_prior(p, problem.rules)
    share = float(np.nan_to_num(cause.noise_sd.get(name, 0.0))) / value / prior
    wider = prior * np.sqrt(_tempered(min(share, 1.0) ** 2, temper))
    draws = value * np.exp(wider * rng.standard_normal(problem.rules.outcome.num_interval_draws))
    return np.minimum(draws, bounds(p, problem.rules)[1])


def _tempered(variance: np.ndarray | float, temper: float) -> np.ndarray | float:
    """Posterior variances, in the prior's, under the likelihood raised to ``temper``."""
    return variance / (temper + (1 - temper) * variance)


def tempered_covariance(covariance: np.ndarray, prior_sd: np.ndarray, temper: float) -> np.ndarray:
    """Covariance (p, p) under the likelihood raised to ``temper``; see the top of the file."""
    # In units of the prior's sds, where S = I and no eigenvalue of the posterior's covariance is above one.
    values, vectors = np.linalg.eigh(covariance / np.outer(prior_sd, prior_sd))
    wider = _tempered(np.clip(values, 1e-300, 1.0), temper)
    return (vectors * wider) @ vectors.T * np.outer(prior_sd, prior_sd)
