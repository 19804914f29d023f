"""Prior probabilities of sets of effects, and tempered evidence."""

from collections import Counter

import numpy as np
import pytest
from pendulum import ARM, PENDULUM, recording_of
from scipy.stats import multivariate_normal

from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.prior import (
    another,
    coarsened,
    log_prior_of,
    of_number,
    statements,
    tempered,
)
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.evidence import learned
from invdyn.models.effects.friction import CoulombFriction, ViscousFriction


@pytest.mark.parametrize("gain", [0.0, 1.0, 40.0, 3000.0])
def test_no_more_than_alpha_nats_count(gain):
    scale = DEFAULT.evidence.temper_scale
    assert gain * tempered(gain, scale) <= scale
    assert gain * tempered(gain, scale) == pytest.approx(gain, rel=gain / DEFAULT.evidence.temper_scale)
    assert tempered(-5.0, 1000.0) == 1.0


def test_another_effect_costs_what_its_number_does():
    assert [another(count) for count in (0, 4)] == [1.0, 1.0]
    assert [another(count) for count in (1, 2, 3)] == pytest.approx([0.16, 0.2, 0.25])


def test_where_more_are_asked_for_each_is_a_quarter_as_likely():
    assert [another(count, DEFAULT.replace(max_effects=6)) for count in (3, 4, 5, 6)] == [0.25, 0.25, 0.25, 1.0]
    assert [another(count, DEFAULT.replace(max_effects=2)) for count in (1, 2)] == [pytest.approx(0.16), 1.0]
    assert of_number(6) == pytest.approx(DEFAULT.evidence.effect_count_prior[4] / 16)
    candidates = considered(diagnosis_problem(recording_of(body=ARM, rows=30), ARM))
    five, six = (log_prior_of(candidates[:count], candidates) for count in (5, 6))
    names = len({e.name for e in candidates})
    assert six - five < np.log(6 / 4 / names) + 1e-9


@pytest.mark.parametrize("body", [PENDULUM, ARM])
def test_prior_sums_to_that_of_the_number(body):
    candidates = considered(diagnosis_problem(recording_of(body=body, rows=30), body))
    assert sum(DEFAULT.evidence.effect_count_prior) == pytest.approx(1.0)
    assert np.exp(log_prior_of((), candidates)) == pytest.approx(DEFAULT.evidence.effect_count_prior[0])
    single = np.array([np.exp(log_prior_of((e,), candidates)) for e in candidates])
    assert single.sum() == pytest.approx(DEFAULT.evidence.effect_count_prior[1])
    # Acting at more joints makes an effect no likelier.
    total = Counter()
    for effect, p in zip(candidates, single, strict=True):
        total[effect.name] += p
    np.testing.assert_allclose(list(total.values()), DEFAULT.evidence.effect_count_prior[1] / len(total))
    pairs = sum(np.exp(log_prior_of((a, b), candidates)) for i, a in enumerate(candidates) for b in candidates[i + 1 :])
    # Of two drawn one after the other, less what would be the same twice.
    assert pairs == pytest.approx(
        DEFAULT.evidence.effect_count_prior[2] * (1 - ((single / DEFAULT.evidence.effect_count_prior[1]) ** 2).sum())
    )


@pytest.mark.parametrize("temper", [1.0, 0.5, 0.1])
def test_the_likelihood_is_tempered_and_not_the_prior(temper):
    """∫ p(y|φ)^ζ p(φ) dφ of a linear-Gaussian model: N(y; Aμ, I/ζ + A diag(s²) Aᵀ), and what the power adds."""
    rng = np.random.default_rng(0)
    A, mu, s = rng.normal(size=(400, 2)) * [5.0, 0.8], np.array([1.0, -2.0]), np.array([0.5, 3.0])
    y = A @ np.array([2.5, 1.0]) + rng.normal(size=400)

    def exact(power):
        wide = multivariate_normal(A @ mu, np.eye(400) / power + (A * s**2) @ A.T).logpdf(y)
        return wide + 0.5 * 400 * ((1 - power) * np.log(2 * np.pi) - np.log(power))

    covariance = np.linalg.inv(A.T @ A + np.diag(s**-2))
    mean = covariance @ (A.T @ y + mu / s**2)
    known, far = learned(covariance, s), 0.5 * (((mean - mu) / s) ** 2).sum()
    assert coarsened(exact(1.0), known, far, temper) == pytest.approx(exact(temper), abs=0.05)


def test_an_effect_that_is_everywhere_is_one_statement():
    """Only where it is said to be: else each place costs an effect of its own, as before."""
    candidates = [ViscousFriction("shoulder"), ViscousFriction("elbow"), CoulombFriction("elbow")]
    both = candidates[:2]
    assert (statements(both), statements(both, {"viscous_friction"})) == (2, 1)
    one, all_of_them = (DEFAULT.evidence.effect_count_prior[1] / 2, DEFAULT.evidence.places_prior[2])
    stated = log_prior_of(both, candidates, everywhere={"viscous_friction"})
    assert np.exp(stated) == pytest.approx(one * all_of_them)
    assert log_prior_of(both, candidates) == log_prior_of(both, candidates, everywhere={"armature"})
    assert stated > log_prior_of(both, candidates)
