"""Which causes of a gap are looked at on MuJoCo's engine, and how probable each is.

All candidates are screened; the best are refined, until none that is left promises as much as the best one gained.
While the best cause leaves something, effects are added to it in the same way. Evidence is tempered and weighed with
the prior of :mod:`..problem.prior`. Within a cause, the share of residuals under the tolerance says that it is all.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from invdyn.diagnosis.engine.causes import Cause, Screened, refined, screened
from invdyn.diagnosis.engine.effects import Candidate
from invdyn.diagnosis.engine.problem import EngineLog
from invdyn.diagnosis.problem.prior import another, coarsened, log_prior_of, tempered
from invdyn.diagnosis.sensitivity.evidence import learned
from invdyn.models.divergence import Diverged


@dataclass(frozen=True)
class Found:
    """Causes with their probabilities of being all there is, and of being a part; and what was screened.

    Attributes:
        none: the simulation as it is.
        causes: best first, "no gap" among them.
        alone, in_part: by a cause's key.
        first: candidates next to "no gap".
        temper: ζ between causes.
    """

    none: Cause
    causes: tuple[Cause, ...]
    alone: dict[str, float]
    in_part: dict[str, float]
    first: tuple[Screened, ...]
    temper: float

    @property
    def best(self) -> Cause:
        """The most probable one, with or without a rest."""
        return self.causes[0]

    @property
    def outside(self) -> float:
        """Probability that something is at work which the catalogue lacks."""
        return min(sum(self.in_part.values()), 1.0)


def search(log: EngineLog, candidates: Sequence[Candidate], most: int) -> Found:
    """Causes of at ``most`` so many effects; raises Diverged where the simulation itself runs away from the log."""
    none = refined(log, (), np.zeros(0))
    pool, rules = {"": none}, log.rules.search
    first = tuple(screened(log, none, candidates)) if candidates else ()
    _refine(log, pool, none, first, rules.max_candidates_alone)
    for count in range(1, most):
        best = max(pool.values(), key=lambda each: each.log_evidence(log))
        if len(best.effects) != count or not leaves(log, best, none):
            break
        others = [each for each in candidates if each.key not in {own.key for own in best.effects}]
        if others:
            _refine(log, pool, best, screened(log, best, others), rules.max_candidates_added)
    return _weighed(log, pool, first, candidates)


def _refine(log: EngineLog, pool: dict[str, Cause], base: Cause, ranked: Sequence[Screened], most: int) -> None:
    """Refine the best of what was screened next to a cause, and add them to the pool."""
    rules, start = log.rules.search, base.log_evidence(log)
    gained = 0.0
    for number, each in enumerate(ranked[:most]):
        promised = each.log_evidence - start
        if promised < -log.rules.evidence.confirm_within and number >= rules.batch_size:
            break
        if rules.rival_factor * max(promised, 0.0) + rules.large_screen_error < gained:
            break
        try:
            cause = refined(log, (*base.effects, each.effect), np.concatenate([base.values, each.values]))
        except Diverged:
            continue
        pool[cause.key] = cause
        gained = max(gained, cause.log_evidence(log) - start)


def leaves(log: EngineLog, cause: Cause, none: Cause) -> bool:
    """Whether a residual, or larger errors than the recording's noise, still say more than the cause alone."""
    rules = log.rules.residual
    whole, rest = (float(each.by_size.max() - each.by_size[0]) for each in (none, cause))
    little = rest <= rules.min_residual_gain + rules.max_share_left**2 * whole
    return not little and cause.size(log) > log.rules.evidence.tolerance


def _weighed(log: EngineLog, pool: dict[str, Cause], first: tuple[Screened, ...], every: Sequence[Candidate]) -> Found:
    none, rules = pool[""], log.rules.evidence
    top = max(each.log_evidence(log) for each in pool.values())
    temper = tempered(top - none.log_evidence(log), rules.temper_scale)
    causes = list(pool.values())
    score = np.array([_score(log, each, temper, every) for each in causes])
    share = np.array([_share(log, each, none, temper) for each in causes])
    # What is left with a cause is one more effect.
    score += np.log([another(len(each.effects), log.rules) if part == 0 else 1.0
                     for each, part in zip(causes, share, strict=True)])  # fmt: skip
    probability = np.exp(score - logsumexp(score))
    order = np.argsort(-probability, kind="stable")
    return Found(
        none,
        tuple(causes[i] for i in order),
        {causes[i].key: float(probability[i] * share[i]) for i in order},
        {causes[i].key: float(probability[i] * (1 - share[i])) for i in order},
        first,
        temper,
    )


def _score(log: EngineLog, cause: Cause, temper: float, every: Sequence[Candidate]) -> float:
    """Tempered log evidence and log prior."""
    evidence = temper * cause.log_evidence(log)
    if cause.effects:
        far = 0.5 * float((((cause.values - cause.prior_mean) / cause.prior_sd) ** 2).sum())
        evidence = coarsened(cause.log_evidence(log), learned(cause.covariance, cause.prior_sd), far, temper)
    return evidence + log_prior_of(cause.effects, every, log.rules)


def _share(log: EngineLog, cause: Cause, none: Cause, temper: float) -> float:
    """Posterior share of residuals that do not matter next to a cause."""
    if leaves(log, cause, none):
        return 0.0
    tolerance, small = log.rules.evidence.tolerance, log.rules.residual.max_share_left
    least = max(tolerance, small * none.size(log)) if cause.effects else tolerance
    weight = temper * cause.by_size + log.regime.log_prior
    return float(np.exp(logsumexp(weight[log.regime.sizes <= least]) - logsumexp(weight)))
