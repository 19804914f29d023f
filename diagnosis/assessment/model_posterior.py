"""Probabilities of causes: the best confirmed by SMC, all weighed by tempered evidence, prior and what they leave.

Each cause has a posterior probability p_c by evidence and prior (:mod:`.prior`). Within it, s_c is the share of
residuals that do not matter: under a stated tolerance, or a tenth of the one that the simulation without it needs.
"No gap" is one of the causes.

    P(c and nothing else) = p_c s_c,    P(c in part) = p_c (1 − s_c),    P(outside the catalogue) = Σ_c p_c (1 − s_c).

A cause explains only a part, s_c = 0, in any of these cases:

- errors of prediction are still correlated from row to row, or lie along the motion;
- outliers of several keypoints come in the same rows, which independent ones do not (swapped ones are a cause of their
  own);
- errors are larger than the noise that the recording shows;
- parameters are such that an effect would not bear its name (:attr:`.CatalogueEntry.credible`), as two stops that meet;
- a residual still gains evidence: L_c = max_size log p − log p(spike) exceeds a hundredth of what it gains without a
  cause by five nats (:meth:`.pool.HypothesisPool.leaves`), and is over the tolerance. It is small then, but
  not due to chance.

An effect whose most probable values are not what its name says gives its probability to its special case
(:attr:`.CatalogueEntry.special_cases`), if that gains all but a tenth of its evidence: Stribeck friction that is less
at rest is Coulomb friction in a smoother form, and something else is left with either.

The most probable cause has to pass the same on a withheld recording (:mod:`.transfer`). Of three effects or more,
withheld rows have to confirm each (:func:`.gap_closure.all_confirmed`): several imitate one that the catalogue lacks.

If s_c = 0, another effect is at work with c. In the choice between causes it costs what a named one does
(:mod:`.prior`): p_c falls by P(n + 1)/P(n), where c has n ≥ 1 effects. What a withheld recording shows is exempt.

With unknown torque a torque is always left, the limb's own, and its errors may lie along the motion. Neither counts
there, and errors are those under an ample torque. A cause that does not improve the prediction of withheld rows beyond
chance is taken back.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import logsumexp

from invdyn.diagnosis.assessment.confirm import Confirmed, confirm_all
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.prediction.innovation_tests import along_motion, prediction_errors, show_more
from invdyn.diagnosis.problem.cause import FittedHypothesis, Scored, best_size, key_of, of_effect
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.prior import another
from invdyn.diagnosis.problem.unknowns import at_far_end


@dataclass(frozen=True)
class Weighed:
    """Causes with probabilities, sorted, and those of their explaining a part; what the catalogue lacks; SMC by key."""

    causes: dict[str, tuple[FittedHypothesis, float]]
    in_part: dict[str, float]
    outside: float
    confirmed: dict[str, Confirmed]
    log_evidence: dict[str, float]

    @property
    def best(self) -> FittedHypothesis:
        """The most probable cause, with or without a rest."""
        return next(iter(self.causes.values()))[0]


def share_explained(bound: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis) -> float:
    """Posterior share of residuals under the tolerance, or small against the one that the simulation needs.

    0 where errors or parameters speak against the cause, and else 1 with unknown torque.
    """
    rules = bound.rules.residual
    errors = prediction_errors(bound, cause)
    if show_more(bound, cause, errors) or not credible(bound, cause):
        return 0.0
    if not bound.regime.knows_torque:
        return 1.0
    along, chance = along_motion(errors, cause)
    if along > 0.5 + rules.max_excess_along + rules.error_margin * chance:
        return 0.0
    return share_of_small_residuals(bound, found, cause)


def share_of_small_residuals(bound: Any, found: HypothesisPool, cause: Scored) -> float:
    """The same by the sizes of the residual alone, of known torques."""
    rules, tolerance = bound.rules.residual, bound.rules.evidence.tolerance
    levels, prior = bound.regime.sizes, bound.regime.log_prior
    if found.leaves(cause) and best_size(bound, cause) > tolerance:
        return 0.0

    # A torque under the tolerance is nothing to look for a cause of, though "no gap" is less than that.
    least = max(levels[1], tolerance) if cause.effects else levels[0]
    little = levels <= max(least, rules.max_share_left * best_size(bound, found.pool[""]))
    weight = found.temper * (cause.by_size - prior) + prior
    return float(np.exp(logsumexp(weight[little]) - logsumexp(weight)))


def weigh(bound: DiagnosisProblem, found: HypothesisPool, seed: int) -> Weighed:
    """Confirm the best by SMC, and turn scores into probabilities; torques under the tolerance are not left."""
    rules, small = bound.rules.evidence, bound.rules.residual.max_share_left
    ranked = found.ranked
    limit = found.score(ranked[0]) - rules.confirm_within
    close = [c for c in ranked if found.score(c) > limit][: rules.max_confirmed]
    runs = confirm_all(bound, close, seed, found.temper, found.workers)
    confirmed = dict(zip((c.key for c in close), runs, strict=True))
    evidence = {c.key: c.log_evidence for c in ranked}
    # Filters that collapsed say less than the linearised evidence does; among the others SMC weighs, and they as a
    # whole keep their place among those that were not confirmed, where the linearised evidence has them.
    if all(np.isfinite(run.log_evidence) and run.log_evidence_sd < rules.max_smc_se for run in confirmed.values()):
        apart = evidence[close[0].key] - confirmed[close[0].key].log_evidence
        evidence |= {name: run.log_evidence + apart for name, run in confirmed.items()}
    score = np.array([found.score(c) + found.temper * (evidence[c.key] - c.log_evidence) for c in ranked])
    probability = np.exp(score - logsumexp(score))
    likely = probability > rules.min_probability
    share = np.array([share_explained(bound, found, c) if p else 1.0 for c, p in zip(ranked, likely, strict=True)])
    least = found.pool[""].log_evidence
    for i in np.flatnonzero(likely):
        j = _special(bound, ranked, ranked[i])
        if j is not None and evidence[ranked[j].key] > small * least + (1 - small) * evidence[ranked[i].key]:
            probability[j], probability[i] = probability[j] + probability[i], 0.0
            share[j] = share_explained(bound, found, ranked[j])
    return weighed_by(found, probability, share, evidence, confirmed)


def weigh_by_sizes(found: HypothesisPool) -> Weighed:
    """Probabilities by evidence and the residual's sizes alone, of torques that are known; nothing is confirmed."""
    ranked = found.ranked
    score = np.array([found.score(cause) for cause in ranked])
    share = np.array([share_of_small_residuals(found.problem, found, cause) for cause in ranked])
    evidence = {cause.key: cause.log_evidence for cause in ranked}
    return weighed_by(found, np.exp(score - logsumexp(score)), share, evidence, {})


def weighed_by(
    found: HypothesisPool,
    probability: np.ndarray,
    share: np.ndarray,
    evidence: dict[str, float],
    confirmed: dict[str, Confirmed],
) -> Weighed:
    """Causes in the order of their probabilities (n,), each of which leaves no more than ``share`` (n,) says."""
    ranked = found.ranked
    # What sizes of the residual tell, the score knows already.
    rest = (share == 0) & ~np.array([found.leaves(c) for c in ranked])
    probability = probability * np.where(rest, [another(found.count(c), found.rules) for c in ranked], 1.0)
    probability /= probability.sum()
    order = np.argsort(-probability, kind="stable")
    causes = {ranked[i].key: (ranked[i], float(probability[i] * share[i])) for i in order}
    in_part = {ranked[i].key: float(probability[i] * (1 - share[i])) for i in order}
    return Weighed(causes, in_part, min(sum(in_part.values()), 1.0), confirmed, evidence)


def _special(bound: DiagnosisProblem, ranked: list[FittedHypothesis], cause: FittedHypothesis) -> int | None:
    """Number of the cause with a special case of that effect of ``cause`` which is not what it is called."""
    keys = [other.key for other in ranked]
    for effect in cause.effects:
        mean = of_effect(effect, cause.values)
        entry = bound.catalogue.of(effect)
        if entry.credible(effect, mean, dict.fromkeys(mean, 0.0), bound.model.scale):
            continue
        for name in (each for each in entry.special_cases if each in bound.catalogue):
            special = bound.catalogue[name].effect(*effect.where)
            narrower = [special if each is effect else each for each in cause.effects]
            if (key := key_of(narrower)) in keys:
                return keys.index(key)
    return None


def too_small(weighed: Weighed) -> Weighed:
    """What every cause leaves is nothing, where the whole gap does not matter (:mod:`.matters`)."""
    causes = {key: (cause, alone + weighed.in_part[key]) for key, (cause, alone) in weighed.causes.items()}
    return replace(weighed, causes=causes, in_part=dict.fromkeys(weighed.in_part, 0.0), outside=0.0)


def in_part_only(weighed: Weighed) -> Weighed:
    """The best cause explains a part, as another recording shows."""
    best, probability = next(iter(weighed.causes.values()))
    causes = weighed.causes | {best.key: (best, 0.0)}
    in_part = weighed.in_part | {best.key: weighed.in_part[best.key] + probability}
    return replace(weighed, causes=causes, in_part=in_part, outside=min(sum(in_part.values()), 1.0))


def only(
    bound: DiagnosisProblem,
    found: HypothesisPool,
    cause: FittedHypothesis,
    log_evidence: dict[str, float],
) -> Weighed:
    """The one cause that there is, and what the catalogue lacks."""
    share = share_explained(bound, found, cause)
    return Weighed({cause.key: (cause, share)}, {cause.key: 1 - share}, 1 - share, {}, log_evidence)


def credible(bound: DiagnosisProblem, cause: FittedHypothesis) -> bool:
    """Whether what was found of each effect is what its name says, and is not as large as anything may be.

    Parameters may make of an effect another one: two stops that meet hold a joint, and Stribeck friction that is less
    at rest than in motion grows with speed. Such a cause explains a part at most.
    """
    for effect in cause.effects:
        mean, sd = of_effect(effect, cause.values), of_effect(effect, cause.sds)
        if not bound.catalogue.of(effect).credible(effect, mean, sd, bound.model.scale):
            return False
        if is_searched(effect) and any(
            at_far_end(p, mean[p.name], bound.rules) for p in effect.parameters(bound.model.scale)
        ):
            return False
    kinds = {effect.name: bound.catalogue.of(effect).credible_together for effect in cause.effects}
    found = [(effect, of_effect(effect, cause.values)) for effect in cause.effects]
    return all(
        together is None or together([each for each in found if each[0].name == name], bound.model.scale)
        for name, together in kinds.items()
    )
