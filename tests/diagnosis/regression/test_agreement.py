"""Whether recordings tell the same numbers: a meta-analysis by hand, and recordings whose friction is known."""

import numpy as np
import pytest
from regressed import BODY, SAME, by_name, fitted_plainly, friction, recorded

from invdyn.diagnosis.regression.agreement import Parts, agreement
from invdyn.diagnosis.regression.stated_numbers import drawn, of_joints
from invdyn.diagnosis.rules import FIXED

KINDS = ("viscous_friction", "coulomb_friction")
ELBOW = ("coulomb_friction", "elbow", "torque")


def test_a_meta_analysis_by_hand():
    """Of 1, 2, 6 with variances 1, 1/2, 1/4: W = 7, θ̄ = 29/7, Q = 32 6/7, τ² = (Q − 2)/(7 − 3) and P = e^{−Q/2}."""
    chance, tau = agreement(np.array([[1.0], [2.0], [6.0]]), np.array([[1.0], [0.5], [0.25]]))
    q = 32 + 6 / 7
    assert chance == pytest.approx([np.exp(-q / 2)])
    assert tau == pytest.approx([np.sqrt((q - 2) / 4)])


def test_a_sum_has_its_own_spread():
    """Two numbers that differ from part to part, and whose sum does not."""
    values = np.array([[1.0, 3.0], [2.0, 2.0], [3.0, 1.0]])
    parts = Parts(values, np.tile(0.01 * np.eye(2), (3, 1, 1)), 0.05)
    each, total = parts.spread(np.eye(2)), parts.turned(np.ones((1, 2))).spread(np.eye(1))
    assert each == pytest.approx(np.sqrt([1 - 0.01] * 2))
    assert total == pytest.approx([0.0])


def of_recordings(seed, elbow):
    """A fit to three recordings with dry friction at the ``elbow`` of these sizes, N·m."""
    made = [lambda m, size=size: friction(m) + np.array([0.0, size - 0.25]) * np.sign(m.qd) for size in elbow]
    logs = [recorded(seed + n, each, seconds=4.0) for n, each in enumerate(made)]
    return fitted_plainly(logs, BODY, KINDS, others=True)


def test_recordings_that_differ_are_told_and_widen_intervals_and_draws():
    effects, fit = of_recordings(0, (0.1, 0.2, 0.2))
    numbers = by_name(of_joints(effects, fit, SAME))
    own = numbers[ELBOW]
    assert {key for key, each in numbers.items() if each.by_part} == {ELBOW}
    assert [value for value, _ in own.by_part] == pytest.approx([0.1, 0.2, 0.2], abs=0.01)
    tau = np.std([0.1, 0.2, 0.2], ddof=1)
    assert own.interval_90[0] < 0.16 - 1.645 * tau
    assert own.interval_90[1] > 0.16 + 1.645 * tau
    sd = np.std([each[ELBOW] for each in drawn(effects, fit, SAME)])
    assert sd == pytest.approx(np.hypot(tau, 0.02), rel=3 / np.sqrt(2 * FIXED.regression_draws))


@pytest.mark.long
def test_recordings_that_agree_are_not_told_apart():
    """None of 16 sets of recordings, nor of their first ones by thirds; at 5 % each, 5 of 32 are one in a hundred."""
    told = 0
    for seed in range(0, 64, 4):
        for rows in (None, recorded(seed, friction, seconds=6.0)):
            _, fit = (
                of_recordings(seed, (0.25,) * 3) if rows is None else fitted_plainly(rows, BODY, KINDS, others=True)
            )
            told += bool((fit.parts.spread(np.eye(4)) > 0).any())
    assert told < 5
