"""Scores against closed forms, and properties that hold for any sample."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import norm

from invdyn.inference.posterior.scores import coverage, crps, quantile, rmse, score_table

FEW = settings(max_examples=60, deadline=None, derandomize=True)
COUNT = st.integers(2, 12)
NUMBERS = st.integers(-800, 800).map(lambda number: number / 8)  # with ties, which stay ties when moved


@st.composite
def samples(draw):
    """Draws (S,), weights (S,) and a truth."""
    count = draw(COUNT)
    values = draw(arrays(float, count, elements=NUMBERS))
    weights = draw(arrays(float, count, elements=st.floats(0.01, 1)))
    return values, weights / weights.sum(), draw(NUMBERS)


def gaussian_crps(truth, mean, sd):
    z = (truth - mean) / sd
    return sd * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / math.sqrt(math.pi))


def pairwise_crps(draws, weights, truth):
    """By its definition, with all pairs."""
    error = (weights * abs(draws - truth)).sum()
    pairs = (weights[:, None] * weights * abs(draws[:, None] - draws)).sum()
    return error - pairs / (2 * (1 - (weights**2).sum()))


@pytest.mark.parametrize("truth", [-3.0, 0.5, 2.0, 4.0])
def test_crps_of_a_gaussian_is_the_analytic_one(truth):
    mean, sd, count = 0.5, 1.7, 20_000
    draws = np.random.default_rng(0).normal(mean, sd, count)
    ours = crps(draws, np.full(count, 1 / count), np.array(truth))
    # |x − y| has a standard deviation of at most that of x; the scatter term's is smaller still
    assert ours == pytest.approx(gaussian_crps(truth, mean, sd), abs=4 * sd / math.sqrt(count))


@pytest.mark.parametrize("count", [2, 3, 10])
def test_crps_is_fair_for_few_draws(count):
    """Its expectation does not depend on how many draws there are."""
    rng = np.random.default_rng(1)
    repeats, truth = 20_000, 0.8
    draws = rng.normal(size=(count, repeats))
    ours = crps(draws, np.full(count, 1 / count), np.full(repeats, truth))
    assert ours.mean() == pytest.approx(gaussian_crps(truth, 0, 1), abs=4 * ours.std() / math.sqrt(repeats))


def test_weights_turn_one_gaussian_into_another():
    """Importance weights: draws of N(0, 2²) weighted to N(1, 1)."""
    count = 100_000
    draws = np.random.default_rng(2).normal(0, 2, count)
    weights = norm.pdf(draws, 1, 1) / norm.pdf(draws, 0, 2)
    weights /= weights.sum()
    error = 5 / math.sqrt(1 / (weights**2).sum())
    assert crps(draws, weights, np.array(0.3)) == pytest.approx(gaussian_crps(0.3, 1, 1), abs=error)
    np.testing.assert_allclose(quantile(draws, weights, (0.05, 0.5, 0.95)), norm.ppf((0.05, 0.5, 0.95), 1), atol=error)


@FEW
@given(samples())
def test_crps_is_its_definition(sample):
    draws, weights, truth = sample
    assert crps(draws, weights, np.array(truth)) == pytest.approx(pairwise_crps(*sample), rel=1e-9, abs=1e-9)


@FEW
@given(samples(), NUMBERS, st.sampled_from([0.25, 1.0, 8.0]))
def test_crps_and_quantiles_move_and_stretch_with_the_draws(sample, shift, scale):
    draws, weights, truth = sample
    one, other = crps(draws, weights, np.array(truth)), crps(scale * draws + shift, weights, scale * truth + shift)
    assert other == pytest.approx(scale * one, rel=1e-7, abs=1e-7)
    levels = (0.05, 0.4, 0.95)
    expected = scale * quantile(draws, weights, levels) + shift
    np.testing.assert_allclose(quantile(scale * draws + shift, weights, levels), expected, rtol=1e-9, atol=1e-9)


@FEW
@given(samples(), st.randoms(use_true_random=False))
def test_order_of_the_draws_does_not_matter(sample, random):
    draws, weights, truth = sample
    order = list(range(len(draws)))
    random.shuffle(order)
    truth = np.array([truth])
    one, other = ((d[:, None], w) for d, w in ((draws, weights), (draws[order], weights[order])))
    np.testing.assert_allclose(crps(*one, truth), crps(*other, truth), atol=1e-9)
    np.testing.assert_allclose(rmse(*one, truth), rmse(*other, truth), atol=1e-9)


@FEW
@given(samples())
def test_quantiles_are_ordered_and_within_the_draws(sample):
    draws, weights, _ = sample
    found = quantile(draws, weights, (0.05, 0.25, 0.5, 0.75, 0.95))
    assert (np.diff(found) >= 0).all()
    assert draws.min() <= found[0]
    assert found[-1] <= draws.max()


@FEW
@given(samples())
def test_a_draw_of_no_weight_changes_nothing(sample):
    draws, weights, truth = sample
    more, none = np.append(draws, 1e3), np.append(weights, 0.0)
    assert crps(more, none, np.array(truth)) == pytest.approx(crps(draws, weights, np.array(truth)), abs=1e-8)
    assert rmse(more[:, None], none, np.array([truth])) == pytest.approx(
        rmse(draws[:, None], weights, np.array([truth]))
    )


def test_one_draw_scores_its_absolute_error():
    assert crps(np.array([2.0]), np.array([1.0]), np.array(5.0)) == 3
    assert crps(np.array([2.0, 9.0]), np.array([1.0, 0.0]), np.array(5.0)) == 3
    both = score_table(np.full((2, 4, 1), 2.0), np.full(2, 0.5), np.full((4, 1), 5.0))
    assert {name: float(score[0]) for name, score in both.items()} == {
        "rmse": 3, "crps": 3, "coverage_50": 0, "coverage_90": 0,
    }  # fmt: skip


@pytest.mark.parametrize("level", [0.5, 0.9])
def test_coverage_of_the_right_distribution_is_nominal(level):
    rng = np.random.default_rng(3)
    count, frames = 400, 2000
    draws, truth = rng.normal(size=(count, frames)), rng.normal(size=frames)
    error = 4 * math.sqrt(level * (1 - level) / frames) + 2 / count  # its own, and that of the quantiles
    assert coverage(draws, np.full(count, 1 / count), truth, level) == pytest.approx(level, abs=error)
    narrow = coverage(0.3 * draws, np.full(count, 1 / count), truth, level)
    exact = 2 * norm.cdf(0.3 * norm.ppf((1 + level) / 2)) - 1
    assert narrow == pytest.approx(exact, abs=error)


def test_unknown_truth_does_not_count():
    rng = np.random.default_rng(4)
    draws, truth = rng.normal(size=(30, 8, 3)), rng.normal(size=(8, 3))
    truth[2:5, 0], truth[:, 2] = np.nan, np.nan
    weights = rng.dirichlet(np.ones(30))
    scores = score_table(draws, weights, truth)
    known = [0, 1, 5, 6, 7]
    alone = score_table(draws[:, known, :1], weights, truth[known, :1])
    for name, score in scores.items():
        assert score[0] == pytest.approx(alone[name][0])
        assert np.isfinite(score[1])
        assert np.isnan(score[2])
