"""Partial pooling against dense Gaussians and t tests."""

import numpy as np
import pytest
from scipy.stats import norm, truncnorm, ttest_ind
from scipy.stats import t as student

from invdyn.inference.study.pooling import Estimate, _at, confounded, groupings, pool

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


@pytest.mark.parametrize("variances", [[0.09, 0.64, 0.04], [0.0025, 0.01, 2.25], [1.0, 4.0, 0.0], [0.0, 0.0, 0.3]])
def test_given_the_variances_it_is_the_dense_gaussian(variances):
    """Means, weights, and slope and information of the restricted likelihood, by its dense projection P."""
    groups = list(groupings(CONDITION, SUBJECT, ONE).values())
    assert len(groups) == 2
    x, whole = design(groups)
    owner = np.repeat([0, 1, 2], [2, *(z.max() + 1 for z in groups)])
    fit, low = (_at(np.array(each), ESTIMATES, ERRORS, whole.T, owner) for each in (variances, [0.3, 0.3, 0.3]))
    exact, other = (dense(np.sqrt(each), ESTIMATES, ERRORS, x, groups) for each in (variances, [0.3, 0.3, 0.3]))
    assert fit.log - low.log == pytest.approx(exact[0] - other[0], abs=1e-8)
    assert fit.means == pytest.approx(exact[1], abs=1e-8)
    linear = fit.weights.T @ ESTIMATES
    assert linear == pytest.approx(exact[1], abs=1e-8)
    parts = [np.eye(12), *((z[:, None] == z).astype(float) for z in groups)]
    cover = np.diag(ERRORS**2) + sum(v * part for v, part in zip(variances, parts, strict=True))
    assert fit.weights.T @ cover @ fit.weights == pytest.approx(exact[2], abs=1e-8)
    inverse = np.linalg.inv(cover)
    p = inverse - inverse @ x @ exact[2] @ x.T @ inverse
    py = p @ ESTIMATES
    score = [0.5 * (py @ part @ py - np.trace(p @ part)) for part in parts]
    information = [[0.5 * np.trace(p @ one @ p @ two) for two in parts] for one in parts]
    assert fit.score == pytest.approx(np.array(score), rel=1e-6)
    assert fit.information == pytest.approx(np.array(information), rel=1e-6)


def test_the_variances_are_the_most_likely_ones():
    subject, condition, session = (np.array(list(each)) for each in ("aaaaabbbbcccc", "xxyyyxyyyxxxy", "1112211221122"))
    y = RNG.normal(size=13) + 2.0 * (subject == "a") + (session == "1")
    found = pool(y, np.full(13, 0.3), condition, subject, session).variances
    groups = list(groupings(condition, subject, session).values())
    x = np.stack([condition == "x", condition == "y"], axis=1).astype(float)
    best = dense(np.sqrt(found), y, np.full(13, 0.3), x, groups)[0]
    for near in found * np.exp(RNG.normal(0, 0.1, (40, len(found)))) + 0.02 * RNG.uniform(size=(40, len(found))):
        assert dense(np.sqrt(near), y, np.full(13, 0.3), x, groups)[0] <= best + 1e-7


@pytest.mark.parametrize("differs", [0.0, 1.0])
@pytest.mark.parametrize("subjects", [2, 3, 6])
def test_in_a_balanced_design_it_is_the_paired_t_test(subjects, differs):
    """Or, where subjects differ less than trials make them, the wider of that and the trials' own scatter."""
    rng = np.random.default_rng(subjects)
    pairs = np.array([-1.0, 1.0])
    effect, level = 1 + differs * rng.normal(size=subjects) + 1e-3 * np.arange(subjects), 2.0 * np.arange(subjects)
    y = level[:, None, None] + np.array([-0.5, 0.5])[:, None] * effect[:, None, None] + 0.4 * pairs
    who, condition = np.repeat(np.arange(subjects).astype(str), 4), np.tile(list("xxyy"), subjects)
    own = pool(y.ravel(), np.full(y.size, 0.05), condition, who, ["1"] * y.size).difference("x", "y")
    assert own.mean == pytest.approx(effect.mean(), abs=1e-6)
    for share in (0.95, 0.975):
        half = student.ppf(share, subjects - 1) * effect.std(ddof=1) / np.sqrt(subjects)
        if not differs:  # then what is left about subjects and conditions, .4² a trial and less of effects
            squares = 0.4**2 * y.size + (effect - effect.mean()) @ (effect - effect.mean())
            freedom = y.size - subjects - 1
            half = max(half, student.ppf(share, freedom) * np.sqrt(squares / freedom / subjects))
        assert own.quantile(share) - own.mean == pytest.approx(half, rel=1e-3)
        assert own.mean - own.quantile(1 - share) == pytest.approx(half, rel=1e-3)


def test_sessions_of_two_subjects_are_two_even_if_they_share_a_name():
    subject, session = np.repeat(["a", "b"], 8), np.tile(np.repeat(["1", "2"], 4), 2)
    y = np.repeat([0.0, 2.0, 5.0, 9.0], 4) + np.tile([-0.1, 0.1], 8)
    labels = np.tile(["x", "x", "y", "y"], 4), subject
    own = pool(y, np.full(16, 0.05), *labels, session).difference("x", "y")
    named = pool(y, np.full(16, 0.05), *labels, np.char.add(subject, session)).difference("x", "y")
    assert own.sds == pytest.approx(named.sds)


@pytest.mark.parametrize("count", [3, 4, 7])
def test_of_one_subject_it_is_the_t_test(count):
    y, labels = np.random.default_rng(count).normal(size=count), ("xyxyyxy"[:count], "a" * count, "1" * count)
    own = pool(y, np.full(count, 0.05), *map(list, labels)).difference("x", "y")
    exact = ttest_ind(*(y[np.array(list(labels[0])) == level] for level in "yx")).confidence_interval(0.9)
    assert (own.quantile(0.05), own.quantile(0.95)) == pytest.approx(exact)


@pytest.mark.parametrize("value", [0.52, 0.0, 1 / 3])
def test_equal_estimates_have_no_difference_and_the_width_of_their_errors(value):
    labels = "xxyyxxyy", "aaaabbbb", "1" * 8
    own = pool(np.full(8, value), np.full(8, 0.02), *map(list, labels)).difference("x", "y")
    assert own.mean == pytest.approx(0.0, abs=1e-9)
    assert own.sds.max() == pytest.approx(0.02 / np.sqrt(2))


@pytest.mark.parametrize("error", [0.02, 0.0])
def test_one_equal_trial_of_each_subject_is_enough(error):
    own = pool(np.ones(3), np.full(3, error), list("xyx"), list("abc"), list("111")).difference("x", "y")
    assert own.mean == pytest.approx(0.0, abs=1e-9)
    assert error <= own.sds.max() < 2 * error + 1e-8


def test_exactly_additive_estimates_are_as_unsure_as_their_errors():
    """Least squares leave 1e-17 there, and the errors say that it is chance."""
    y = np.array([1.0, 1.0, 2.0, 2.0, 1.5, 1.5, 2.5, 2.5])
    labels = "xxxxyyyy", "aabbaabb", "1" * 8
    own = pool(y, np.full(8, 0.02), *map(list, labels)).difference("x", "y")
    assert own.mean == pytest.approx(0.5, abs=1e-3)
    assert own.quantile(0.95) - own.mean == pytest.approx(norm.ppf(0.95) * 0.02 / np.sqrt(2))


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
        own = pool(y, np.full(len(y), 0.05), *labels).difference("0", "1")
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


def test_a_further_trial_is_less_sure_than_the_average():
    pooled = pool(ESTIMATES, ERRORS, CONDITION, SUBJECT, ONE)
    further = pooled.new_trial("x").sds[0] ** 2 - pooled.average("x").sds[0] ** 2
    assert pooled.variances.sum() <= further < 2 * pooled.variances.sum()


def test_a_further_trial_is_no_average_where_trials_hardly_differ():
    """Of four equal trials of error 1 a step leads to θ = −1, of sd √(2/3)."""
    one = pool(np.ones(4), np.ones(4), ["x"] * 4, ["a"] * 4, ["1"] * 4)
    assert one.variances == pytest.approx([0.0])
    cut = truncnorm(1 / np.sqrt(2 / 3), np.inf, loc=-1, scale=np.sqrt(2 / 3)).mean()
    assert one.new_trial("x").sds[0] ** 2 == pytest.approx(1 / 4 + cut)


def test_one_trial_of_each_condition_has_the_scatter_of_all():
    own = pool(np.array([1.0, 3.0]), np.full(2, 0.1), ["x", "y"], ["a", "a"], ["1", "1"]).difference("x", "y")
    assert own.quantile(0.95) == pytest.approx(2 + student.ppf(0.95, 1) * 2)


def test_tails_are_the_larger_ones_of_two():
    own = Estimate(2.0, np.array([1.0, 0.3]), np.array([np.inf, 1.0]))
    assert own.quantile(0.2) == pytest.approx(2 + norm.ppf(0.2))
    assert own.quantile(0.99) == pytest.approx(2 + 0.3 * student.ppf(0.99, 1))
    assert own.below(own.quantile(0.95)) == pytest.approx(0.95)
    assert own.direction == pytest.approx(student.cdf(2.0 / 0.3, 1))


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
    assert pool(y, np.ones(len(y)), list(condition), list(subject), list(session)).confounded == what


@pytest.mark.parametrize("estimates", [[1.0], [1.0, np.nan]])
def test_too_little_is_refused(estimates):
    with pytest.raises(ValueError, match="2 trials or more"):
        pool(np.array(estimates), np.ones(len(estimates)), "xy"[: len(estimates)], "ab", "11")
