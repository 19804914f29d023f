"""The test for change: few false alarms on standard innovations, prompt ones when these widen or shift."""

import numpy as np
import pytest

from invdyn.inference import ChangeTest

RATE = 50.0


def alarms(test, innovations):
    """Rows at which there is an alarm, after each of which the test starts again."""
    found = []
    for k, z in enumerate(innovations):
        if test.add(z):
            found.append(k)
            test.restart()
    return found


def test_the_bound_on_false_alarms_holds():
    """A threshold of 1/60 hour, 3,000 rows: at most one alarm in as many, within Monte Carlo error."""
    test = ChangeTest(RATE, hours=1 / 60)
    assert np.exp(test.log_threshold) == pytest.approx(3000)
    found = alarms(test, np.random.default_rng(0).normal(size=(30_000, 3)) * 1.1)
    assert len(found) <= 10 + 2 * 10**0.5
    assert not alarms(ChangeTest(RATE), np.random.default_rng(1).normal(size=(20_000, 3)))


def test_the_ratio_is_that_of_the_densities():
    """After three rows against the sum written out, of one entry."""
    from scipy.stats import multivariate_normal, norm

    from invdyn.inference.online.change import SHIFT, SLACK, WIDER

    z = np.array([0.3, -1.2, 2.0])
    test = ChangeTest(RATE)
    for each in z:
        test.add(np.array([each]))
    scaled, total = z / SLACK, 0.0
    for k in range(3):
        rest = scaled[k:]
        null = norm.logpdf(rest).sum()
        total += 0.5 * np.exp(norm.logpdf(rest, scale=WIDER).sum() - null)
        shifted = np.eye(len(rest)) + SHIFT**2
        total += 0.5 * np.exp(multivariate_normal.logpdf(rest, cov=shifted) - null)
    assert np.exp(test.log_ratio) == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize("change", [lambda z: 2 * z, lambda z: z + np.array([1.0, 0, 0])], ids=["wider", "shifted"])
def test_a_change_is_told_within_two_seconds(change):
    rng = np.random.default_rng(2)
    for _ in range(10):
        before, after = rng.normal(size=(200, 3)), change(rng.normal(size=(100, 3)))
        test = ChangeTest(RATE)
        assert not alarms(test, before)
        assert any(test.add(z) for z in after)
        assert 0 <= test.since <= 100


@pytest.mark.parametrize("before", [30, 190, 230])
def test_it_tells_how_long_ago_the_change_was(before):
    """Also where starts of two seconds, 100 rows, have made place for others."""
    z = np.concatenate([np.tile([[0.5, -0.5], [-0.5, 0.5]], (before // 2, 1)), np.tile([[4.0], [-4.0]], (2, 2))])
    test, fresh = ChangeTest(RATE, hours=1e6), ChangeTest(RATE, hours=1e6)
    for row in z:
        test.add(row)
    for row in z[-100:]:
        fresh.add(row)
    assert test.since == 3
    assert test.log_ratio == pytest.approx(fresh.log_ratio, rel=1e-12)


def test_missing_entries_say_nothing():
    rng = np.random.default_rng(3)
    z = rng.normal(size=(50, 2))
    one, other = ChangeTest(RATE), ChangeTest(RATE)
    for row in z:
        one.add(row[:1])
        other.add(np.array([row[0], np.nan]))
        other.add(np.full(2, np.nan))
    assert one.log_ratio == pytest.approx(other.log_ratio, rel=1e-12)


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="positive rate"):
        ChangeTest(0.0)
