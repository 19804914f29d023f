"""Partial pooling against dense Gaussians and integrals on a grid."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import chi2, halfnorm, norm
from scipy.stats import t as student

from invdyn.inference.study.pooling import Mixture, Pooled, _given, _prior_scales, confounded, groupings, pool

SUBJECT = np.repeat(["a", "b", "c"], 4)
CONDITION = np.tile(["x", "x", "y", "y"], 3)
ONE = np.full(12, "1")
RNG = np.random.default_rng(3)
ERRORS = RNG.uniform(0.1, 0.4, 12)
ESTIMATES = np.repeat([0.0, 1.0, 0.4], 4) + 0.7 * (CONDITION == "y") + RNG.normal(0, 0.3, 12)


def dense(tau, y, s, x, groups):
    """log p(y | τ) and moments of μ by the covariance (n, n) of y, as generalised least squares has them."""
    cover = np.diag(tau[0] ** 2 + s**2)
    for spread, number in zip(tau[1:], groups, strict=True):
        cover += spread**2 * (number[:, None] == number[None, :])
    inverse = np.linalg.inv(cover)
    information = x.T @ inverse @ x
    mean = np.linalg.solve(information, x.T @ inverse @ y)
    off = y - x @ mean
    log = -0.5 * (np.linalg.slogdet(cover)[1] + np.linalg.slogdet(information)[1] + off @ inverse @ off)
    return log, mean, np.linalg.inv(information)


def design(groups):
    x = np.stack([CONDITION == "x", CONDITION == "y"], axis=1).astype(float)
    return x, np.concatenate([x, *(np.eye(z.max() + 1)[z] for z in groups)], axis=1)


def test_given_the_spreads_it_is_the_dense_gaussian():
    groups = list(groupings(CONDITION, SUBJECT, ONE).values())
    assert len(groups) == 2
    x, whole = design(groups)
    taus = np.array([[0.3, 0.8, 0.2], [0.05, 0.1, 1.5], [1.0, 2.0, 0.01]])
    sizes = np.array([z.max() + 1 for z in groups])
    log, means, covariances = _given(np.log(taus), ESTIMATES, ERRORS, whole, 2, sizes)
    exact = [dense(tau, ESTIMATES, ERRORS, x, groups) for tau in taus]
    assert log - log[0] == pytest.approx([each[0] - exact[0][0] for each in exact], abs=1e-8)
    assert means == pytest.approx(np.array([each[1] for each in exact]), abs=1e-8)
    assert covariances == pytest.approx(np.array([each[2] for each in exact]), abs=1e-8)


def test_the_spreads_are_integrated_out_as_on_a_grid():
    """Three spreads on 24³ points of their priors, half-normal; whether their sds are right, coverage tells."""
    subjects, conditions = (np.unique(each, return_inverse=True)[1] for each in (SUBJECT, CONDITION))
    whose, by_name = {"subject": subjects, "session": subjects}, groupings(CONDITION, SUBJECT, ONE)
    within, between, cell = _prior_scales(ESTIMATES, ERRORS, conditions, whose, by_name)
    groups = list(groupings(CONDITION, SUBJECT, ONE).values())
    x, _ = design(groups)
    points = halfnorm.ppf((np.arange(24) + 0.5) / 24)
    grid = np.array(np.meshgrid(2 * within * points, between * points, cell * points)).reshape(3, -1).T
    parts = [dense(tau, ESTIMATES, ERRORS, x, groups) for tau in grid]
    logs = np.array([each[0] for each in parts])
    weights = np.exp(logs - logsumexp(logs))
    contrast = np.array([-1.0, 1.0])
    exact = Mixture(
        weights,
        np.array([contrast @ each[1] for each in parts]),
        np.sqrt([contrast @ each[2] @ contrast for each in parts]),
    )
    found = pool(ESTIMATES, ERRORS, CONDITION, SUBJECT, ONE).difference("x", "y")
    assert found.mean == pytest.approx(exact.mean, abs=0.05 * exact.sd)
    assert found.sd == pytest.approx(exact.sd, rel=0.06)
    for share in (0.05, 0.95):
        assert found.quantile(share) == pytest.approx(exact.quantile(share), abs=0.1 * exact.sd)
    assert found.direction == pytest.approx(exact.direction, abs=0.01)


@pytest.mark.parametrize("of_cells", [0.0, 1.0])
def test_the_scales_of_the_priors_are_those_of_sums_of_squares(of_cells):
    """Of three subjects under two conditions, by row and column means; cells that differ by more have the limit."""
    trials = np.tile([-0.1, 0.1], (3, 2, 1))
    level, effect = np.array([-2.0, 0.5, 1.5])[:, None, None], np.array([-0.4, 0.4])[None, :, None]
    cells = of_cells * np.array([1.0, -3.0, 2.0])[:, None, None] * effect
    y = (level + effect + cells + trials).reshape(-1)
    subjects, conditions = (np.unique(each, return_inverse=True)[1] for each in (SUBJECT, CONDITION))
    groups = groupings(CONDITION, SUBJECT, ONE)
    found = _prior_scales(y, np.full(12, 1e-6), conditions, {"subject": subjects, "session": subjects}, groups)
    of_effect = np.sqrt(((cells + trials) ** 2).sum() / 8 / 2)
    limit = np.sqrt((cells[..., 0] ** 2).sum() / chi2.ppf(0.15, 2))
    expected = [(effect + cells + trials).std(), y.std(), max(of_effect, limit)]
    assert found == pytest.approx(expected, rel=1e-6)


def test_sessions_of_two_subjects_are_two_even_if_they_share_a_name():
    subject, session = np.repeat(["a", "b"], 8), np.tile(np.repeat(["1", "2"], 4), 2)
    y = np.repeat([0.0, 2.0, 5.0, 9.0], 4) + np.tile([-0.1, 0.1], 8)
    labels = np.tile(["x", "x", "y", "y"], 4), subject
    own = pool(y, np.full(16, 0.05), *labels, session, 64).difference("x", "y")
    named = pool(y, np.full(16, 0.05), *labels, np.char.add(subject, session), 64).difference("x", "y")
    assert own.sd == pytest.approx(named.sd)


@pytest.mark.parametrize("count", [3, 4])
def test_few_trials_of_one_subject_have_intervals_that_hold_the_truth(count):
    """As by Student's t; 300 studies without an effect, so that a share of .9 is known to .02."""
    rng, labels = np.random.default_rng(1), ("xyxy"[:count], "a" * count, "1" * count)
    held, found = [], []
    for _ in range(300):
        own = pool(rng.normal(size=count), np.full(count, 0.05), *map(list, labels), 64).difference("x", "y")
        held.append(0.05 < own.below(0.0) < 0.95)
        found.append(own.direction >= 0.975)
    assert np.mean(held) > 0.88
    assert np.mean(found) < 0.06


@pytest.mark.parametrize("value", [0.52, 0.0, 1 / 3])
def test_equal_estimates_have_no_difference_and_the_width_of_their_errors(value):
    labels = "xxyyxxyy", "aaaabbbb", "1" * 8
    own = pool(np.full(8, value), np.full(8, 0.02), *map(list, labels), 256).difference("x", "y")
    assert own.mean == pytest.approx(0.0, abs=1e-9)
    assert 0.02 / np.sqrt(2) < own.sd < 0.08


@pytest.mark.parametrize("error", [0.02, 0.0])
def test_one_equal_trial_of_each_subject_is_enough(error):
    own = pool(np.ones(3), np.full(3, error), list("xyx"), list("abc"), list("111"), 64).difference("x", "y")
    assert own.mean == pytest.approx(0.0, abs=1e-9)
    assert error / 2 <= own.sd < 5 * error + 1e-8


def test_exactly_additive_estimates_are_as_unsure_as_their_errors():
    """Least squares leave 1e-17 there, and the errors say that it is chance."""
    y = np.array([1.0, 1.0, 2.0, 2.0, 1.5, 1.5, 2.5, 2.5])
    labels = "xxxxyyyy", "aabbaabb", "1" * 8
    own = pool(y, np.full(8, 0.02), *map(list, labels), 256).difference("x", "y")
    assert own.mean == pytest.approx(0.5, abs=1e-3)
    assert own.quantile(0.95) - own.quantile(0.05) > 0.1


@pytest.mark.parametrize("error", [0.001, 0.03])
@pytest.mark.parametrize(("subjects", "falsely"), [(2, 0.07), (4, 0.05), (8, 0.05)])
def test_of_precise_trials_the_interval_is_nearly_students(subjects, falsely, error):
    """Student's t, exact there, says how often an interval of this width misses the effect, and finds one falsely."""
    rng = np.random.default_rng(subjects)
    effect, level = rng.normal(size=subjects), 2 * rng.normal(size=subjects)
    y = np.outer(effect, [-0.5, -0.5, 0.5, 0.5]) + level[:, None] + error * np.array([-1, 1, -1, 1])
    who, condition = np.repeat(np.arange(subjects).astype(str), 4), np.tile(list("xxyy"), subjects)
    own = pool(y.ravel(), np.full(y.size, error), condition, who, ["1"] * y.size).difference("x", "y")
    assert own.mean == pytest.approx(effect.mean(), abs=0.01 * own.sd)
    for share, low, high in ((0.95, 0.07, 0.1), (0.975, 0.035, falsely)):
        half = (own.quantile(share) - own.quantile(1 - share)) / 2
        missed = 2 * student.sf(half * np.sqrt(subjects) / effect.std(ddof=1), subjects - 1)
        assert low < missed < high


def test_trials_of_few_subjects_have_intervals_that_hold_the_effect():
    """Effects N(0, .3²) by subject, trials' sd .1 and s = .05; 150 studies, so that a share of .9 is known to .025."""
    subjects, trials = 3, 2
    rng, held, found = np.random.default_rng(1032), [], []
    subject, condition = (
        np.repeat(np.arange(subjects), 2 * trials),
        np.tile(np.repeat([0, 1], trials), subjects),
    )
    for _ in range(150):
        level, effect = rng.normal(size=subjects), 0.3 * rng.normal(size=subjects)
        y = level[subject] + condition * effect[subject] + rng.normal(0, np.hypot(0.1, 0.05), len(subject))
        labels = condition.astype(str), subject.astype(str), ["1"] * len(y)
        own = pool(y, np.full(len(y), 0.05), *labels, 64).difference("0", "1")
        held.append(0.05 <= own.below(0.0) <= 0.95)
        found.append(own.direction >= 0.975)
    assert np.mean(held) >= 0.86
    assert np.mean(found) <= 0.08


def test_trials_known_exactly_and_alike_leave_the_plain_difference():
    y = np.array([1.0, 1.0, 3.0, 3.0]) + np.array([-1e-3, 1e-3, -1e-3, 1e-3])
    pooled = pool(y, np.full(4, 1e-3), ["x", "x", "y", "y"], ["a"] * 4, ["1"] * 4)
    own = pooled.difference("x", "y")
    assert own.mean == pytest.approx(2.0, abs=1e-3)
    assert own.quantile(0.05) < 2.0 < own.quantile(0.95)
    assert own.direction > 0.99
    assert pooled.average("y").mean == pytest.approx(3.0, abs=1e-3)


def test_the_prior_of_the_spread_between_trials_is_twice_their_own():
    """Four trials of one subject, where that prior says much: one integral."""
    y, s = np.array([0.1, 0.9, 2.2, 1.4]), np.full(4, 0.05)
    groups = [tau**2 + s**2 for tau in 2 * (y - y.mean()).std() * halfnorm.ppf((np.arange(4000) + 0.5) / 4000)]
    x = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    parts = [dense(np.array([0.0]), y, np.sqrt(variance), x, []) for variance in groups]
    logs = np.array([each[0] for each in parts])
    contrast = np.array([-1.0, 1.0])
    exact = Mixture(
        np.exp(logs - logsumexp(logs)),
        np.array([contrast @ each[1] for each in parts]),
        np.sqrt([contrast @ each[2] @ contrast for each in parts]),
    )
    found = pool(y, s, list("xxyy"), ["a"] * 4, ["1"] * 4).difference("x", "y")
    assert found.mean == pytest.approx(exact.mean, abs=1e-6)
    assert found.sd == pytest.approx(exact.sd, rel=0.02)
    for share in (0.05, 0.95):
        assert found.quantile(share) == pytest.approx(exact.quantile(share), abs=0.02 * exact.sd)


def test_a_further_trial_has_the_spreads_of_all_groupings():
    one = Pooled(
        ("x",), np.ones(1), np.ones((1, 1)), np.full((1, 1, 1), 0.04), np.array([[0.3, 0.4]]), ("subject",), ""
    )
    assert one.new_trial("x").sd == pytest.approx(np.sqrt(0.04 + 0.09 + 0.16))


def test_a_further_trial_is_less_sure_than_the_average():
    pooled = pool(ESTIMATES, ERRORS, CONDITION, SUBJECT, ONE)
    assert pooled.new_trial("x").sd > pooled.average("x").sd


def test_units_do_not_matter():
    own = pool(ESTIMATES, ERRORS, CONDITION, SUBJECT, ONE).difference("x", "y")
    other = pool(1000 * ESTIMATES + 5, 1000 * ERRORS, CONDITION, SUBJECT, ONE).difference("x", "y")
    assert other.mean == pytest.approx(1000 * own.mean)
    assert other.quantile(0.05) == pytest.approx(1000 * own.quantile(0.05))


@pytest.mark.parametrize(
    ("condition", "subject", "session", "names"),
    [
        ("xxyy", "aaaa", "1111", []),
        ("xyxy", "aabb", "1111", ["subject"]),  # a cell of one trial: its own spread is the trial's
        ("xxyyxxyy", "aaaabbbb", "1" * 8, ["subject", "subject × condition"]),
        ("xxyyxxyy", "aaaaaaaa", "11223344", ["session"]),  # a session has one condition
        ("xxyy", "aabb", "1111", []),  # a subject has one condition, and nobody else has it
    ],
)
def test_groupings_are_those_that_the_design_tells_apart(condition, subject, session, names):
    assert list(groupings(condition, subject, session)) == names


@pytest.mark.parametrize(
    ("condition", "subject", "session", "what"),
    [
        ("xxyy", "aabb", "1111", "subject"),
        ("xxyy", "aaaa", "1122", "session"),
        ("xxyy", "aaaa", "1212", ""),
        ("xxyyxx", "aabbcc", "111111", ""),  # two subjects of a condition tell by how much subjects differ
        ("xxxx", "aaaa", "1111", ""),
        ("xxyy", "abab", "1122", ""),  # sessions of two subjects differ even if they share a name
    ],
)
def test_a_condition_of_one_subject_or_session_may_be_its_effect(condition, subject, session, what):
    assert confounded(condition, subject, session) == what
    y = np.arange(float(len(condition)))
    assert pool(y, np.ones(len(y)), list(condition), list(subject), list(session), 64).confounded == what


def test_quantiles_of_a_mixture_are_those_of_its_distribution():
    one = Mixture(np.array([1.0]), np.array([2.0]), np.array([0.5]))
    assert one.quantile(0.95) == pytest.approx(norm.ppf(0.95, 2.0, 0.5))
    two = Mixture(np.array([0.5, 0.5]), np.array([-3.0, 3.0]), np.array([0.1, 0.1]))
    assert two.mean == pytest.approx(0.0)
    assert two.sd == pytest.approx(np.sqrt(9.01))
    assert two.direction == pytest.approx(0.5)


@pytest.mark.parametrize("estimates", [[1.0], [1.0, np.nan]])
def test_too_little_is_refused(estimates):
    with pytest.raises(ValueError, match="2 trials or more"):
        pool(np.array(estimates), np.ones(len(estimates)), "xy"[: len(estimates)], "ab", "11")
