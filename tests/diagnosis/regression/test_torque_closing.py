"""The interval of the share of a missing torque that effects close: how often it has that of a later motion."""

import math

import numpy as np
import pytest

from invdyn.diagnosis.regression.torque_closing import closing, share_closed


def errors(rng, parts, length=50, sd=0.5):
    """Errors (R, 1) without and with effects, whose ratio differs by log-normal factors from part to part."""
    before = rng.standard_normal(parts * length)
    size = np.repeat(0.3 * np.exp(sd * rng.standard_normal(parts)), length)
    return before[:, None], (size * rng.standard_normal(len(size)))[:, None]


def test_it_has_the_share_of_a_later_motion():
    """Of 400 logs the binomial's sd is .015 at .9; a t of a variance that is no Gaussian's may be off by .04."""
    rng, inside, below = np.random.default_rng(0), [], []
    for _ in range(400):
        fitted, held, later = (errors(rng, parts) for parts in (12, 6, 6))
        low, high = closing(*held, fitted).interval_90
        then = share_closed(*later)[0]
        inside.append(low <= then <= high)
        below.append(low <= then)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.04 + 3 * 0.015)
    assert np.mean(below) == pytest.approx(0.95, abs=0.04 + 3 * 0.011)


def test_parts_that_differ_make_it_wider_wherever_they_are():
    """Fitted rows that are explained otherwise than the held-out ones tell what a later motion may be like."""
    rng = np.random.default_rng(1)
    held, alike, other = errors(rng, 6, sd=0.0), errors(rng, 12, sd=0.0), errors(rng, 12, sd=0.0)
    narrow, wide = (
        np.subtract(*closing(*held, each).interval_90[::-1]) for each in (alike, (other[0], 3.0 * other[1]))
    )
    assert wide > 2 * narrow


def test_the_share_is_of_rms_and_a_joint_at_rest_does_not_count():
    before, after = np.array([[2.0, 0.0]] * 8), np.array([[1.0, 0.0]] * 8)
    found = closing(before, after, (before, after))
    assert (found.share, *found.interval_90) == pytest.approx((0.5, 0.5, 0.5))
    assert found.to_json(("a", "b"))["closed_by_joint"]["a"] == 0.5
    assert closing(before, before, (before, before)).share == 0.0


def test_one_row_has_no_interval():
    share, low, high = share_closed(np.array([2.0]), np.array([1.0]))
    assert share == 0.5
    assert math.isnan(low)
    assert math.isnan(high)
