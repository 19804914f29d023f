"""Prior probabilities of causes.

The number of effects at work comes first, then which ones, then where each acts, with equal probabilities:

    P(0) = .4, P(1) = .5, P(2) = .08, P(3) = .016, P(4) = .004,     P(effect) = 1/E for E effects in the catalogue,
    P(n + 1) = P(n)/4 for n ≥ 4, where more are wanted,
    P(place | effect) = 1/places.

An effect that a regression states at every joint (:mod:`..regression.regress`) is one of n, at all places together:
robots' joints are similar. Its places then have P(all) of `places_prior`, for P(place | effect)^count.

An effect therefore does not become likelier by acting at more joints, and a second effect must earn about e⁵ to be
believed. "Something else" needs no prior of its own: it is the slab of the residual's size (:mod:`.whiten`).

Reality's friction is not quite the catalogue's, and the larger an effect, the more nats that small difference is worth.
Evidence is therefore raised to a power ζ (a coarsened posterior: Miller & Dunson 2019, "Robust Bayesian inference via
coarsening"), with G the nats that the best cause gains over none:

    ζ = 1 / (1 + G/α)

That power is the likelihood's; the prior of parameters stays as it is. With a posterior N(φ̂, Σ), a prior N(μ, diag s²)
and 1 + λ_i the eigenvalues of diag(s) Σ⁻¹ diag(s),

    log p_ζ(y) = ζ log p(y) − ½ Σ_i [log(1 + ζλ_i) − ζ log(1 + λ_i)] − ½ (1 − ζ) |(φ̂ − μ)/s|²

so that parameters which are known well, or far from what was expected, cost what they do without tempering. Small gaps
are weighed as they are. Of large ones no more than α nats count, however many rows there are. For the parameters of one
cause α is larger. It is such that .90 of 740 intervals of opened blind runs hold the truth; of sealed ones after it
.936 of 311 and .904 of 312 do. Outliers, whose thousands of nats nothing else imitates, have a ζ of their own
(:meth:`.pool.HypothesisPool.score`).
"""

import math
from collections.abc import Collection, Sequence
from typing import Protocol

import numpy as np

from invdyn.diagnosis.rules import DEFAULT, Rules


class Named(Protocol):
    """An effect at a place."""

    @property
    def name(self) -> str:
        """The effect's, without the place."""


def tempered(gain: float, alpha: float) -> float:
    """ζ, for G = ``gain`` and α = ``alpha``."""
    return 1 / (1 + max(gain, 0.0) / alpha)


def coarsened(log_evidence: float, learned: np.ndarray, far: float, temper: float) -> float:
    """Log p_ζ, ζ = ``temper``, from log p, λ (p,) and ``far`` = ½ |(φ̂ − μ)/s|²."""
    narrowed = np.log1p(temper * learned) - temper * np.log1p(learned)
    return temper * log_evidence - 0.5 * float(narrowed.sum()) - (1 - temper) * far


def of_number(count: int, rules: Rules = DEFAULT) -> float:
    """P(n), n = ``count``."""
    given = rules.evidence.effect_count_prior
    last = len(given) - 1
    return given[min(count, last)] / 4.0 ** max(count - last, 0)


def another(count: int, rules: Rules = DEFAULT) -> float:
    """P(n + 1)/P(n), for n = ``count`` ≥ 1 effects; 1 where there is none, or as many as there may be."""
    more = 0 < count < rules.search.max_effects
    return of_number(count + 1, rules) / of_number(count, rules) if more else 1.0


def statements(effects: Sequence[Named], everywhere: Collection[str] = ()) -> int:
    """How many effects are stated: one of several places counts once, where it is one of ``everywhere``."""
    names = [effect.name for effect in effects]
    return sum(name not in everywhere for name in names) + len({*names} & {*everywhere})


def log_prior_of(
    effects: Sequence[Named],
    candidates: Sequence[Named],
    rules: Rules = DEFAULT,
    everywhere: Collection[str] = (),
) -> float:
    """Log prior probability of a cause among ``candidates``, all effects at all places that are considered."""
    names = {candidate.name for candidate in candidates}
    count = statements(effects, everywhere)
    total = math.log(of_number(count, rules)) + math.lgamma(count + 1) - count * math.log(max(len(names), 1))
    stated = {effect.name for effect in effects} & {*everywhere}
    total += len(stated) * math.log(rules.evidence.places_prior[2])
    for effect in effects:
        if effect.name not in stated:
            total -= math.log(max(sum(candidate.name == effect.name for candidate in candidates), 1))
    return total
