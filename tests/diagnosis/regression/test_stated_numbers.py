"""Numbers of a regression: their doubt, probabilities, and those of effects that are not stated."""

from dataclasses import replace

import numpy as np
import pytest
from regressed import (
    BODY,
    FILED,
    FOUR,
    SAME,
    by_name,
    fitted_plainly,
    found,
    friction,
    of_parts,
    recorded,
)

from invdyn.diagnosis.regression.linear_effects import expected, linear_effects
from invdyn.diagnosis.regression.low_pass import cutoff_of
from invdyn.diagnosis.regression.measured_motion import measured_motion
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.regression.stated_numbers import of_joints, of_links, of_others, stated
from invdyn.diagnosis.regression.weighted_fit import weighted_fit
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.dynamics.registry import dynamics_for


def test_a_torque_that_is_not_looked_into_is_in_the_intervals():
    """Of 2 % of what the elbow needs, much like dry friction: it takes that for more of it."""
    recording = recorded(20, lambda m: friction(m) + np.array([0.0, 0.02]) * np.tanh(m.qd / 0.2))
    for tolerance, inside in ((0.0, False), (0.03, True)):
        result = regress(recording, BODY, rules=DEFAULT.replace(tolerance=tolerance))
        low, high = found(result)["coulomb_friction", "elbow", "torque"].interval_90
        assert (low < 0.25 < high) == inside


@pytest.mark.slow
def test_intervals_hold_the_truth():
    """90 % intervals of four numbers in eight recordings: .7 of 32 is a binomial's chance of one in a thousand.

    Without a tolerance, and errors in sds are not small either: of t with five degrees of freedom their rms is 1.3.
    """
    hits, off = [], []
    truths = {"viscous_friction": (0.3, 0.1), "coulomb_friction": (0.5, 0.25)}
    for seed in range(20, 28):
        for each in regress(recorded(seed, friction), BODY, rules=DEFAULT.replace(tolerance=0.0)).numbers:
            if each.effect in truths:
                truth = truths[each.effect][BODY.joint_names.index(each.place)]
                hits.append(each.interval_90[0] <= truth <= each.interval_90[1])
                off.append((each.value - truth) / each.sd)
    assert len(hits) >= 28
    assert np.mean(hits) > 0.7
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 2.2


@pytest.fixture(scope="module")
def weak():
    """Motors that give .8 times what they are told, and a file's friction and springs, of which some are other."""
    rows = recorded(40, lambda m: of_parts(m) + 0.3 * m.qd - 1.0 * m.q)
    rows = replace(rows, torques=rows.torques / 0.8)
    return rows, by_name(of_joints(*fitted_plainly(rows, FILED, FOUR), SAME))


@pytest.mark.parametrize("left_out", FOUR[1:])
def test_an_effect_that_is_not_stated_has_the_numbers_that_it_would_have(weak, left_out):
    """In the robot's units, with the file's own number and all parameters; rows have weights from a fit without it."""
    rows, whole = weak
    fit = fitted_plainly(rows, FILED, tuple(kind for kind in FOUR if kind != left_out), others=True)
    others = by_name(of_others(*fit, SAME))
    assert {key for key in whole if key[0] == left_out} == {key for key in others if key[0] == left_out}
    for key in (key for key in whole if key[0] == left_out):
        own, stated_ones = others[key], whole[key]
        assert own.value == pytest.approx(stated_ones.value, abs=0.5 * stated_ones.sd)
        assert 1 / 1.6 < np.subtract(*own.interval_90) / np.subtract(*stated_ones.interval_90) < 1.6
        assert (own.unit, own.of_file) == (stated_ones.unit, stated_ones.of_file)


def with_one_column(key, column, missing, required, tolerance=0.0):
    """A fit of one effect to a short motion: its ``column`` is a function of (R, 2), ``missing`` one of that."""
    rows = recorded(3, friction, seconds=3.0)
    motion, dynamics = measured_motion(rows, BODY), dynamics_for(BODY)
    rules = DEFAULT.replace(tolerance=tolerance)
    effects = linear_effects(BODY, motion, expected(dynamics, BODY, motion, False), False, rules, cutoff_of(motion))
    number = [*zip(effects.kinds, effects.places, effects.names, strict=True)].index(key)
    X = column(motion.q.shape)
    values = tuple((at == number)[:, None] * X[:, k] for k, at in enumerate(effects.columns.at))
    own = replace(effects, columns=replace(effects.columns, values=values), missing=missing(X), required=required)
    fit = weighted_fit(own, motion, rules, (key[0],))
    assert fit.chosen.columns == (number,)
    return fit


def test_a_torque_at_two_joints_shifts_a_links_number_by_that_of_both():
    """A column that is 1 at both: a torque of 1 N·m there is a coefficient of 1, of whose tolerance it is."""
    noise, key = np.random.default_rng(0), ("inertial_error", "fore", "first moment")
    fit = with_one_column(key, np.ones, lambda X: 3.0 + 0.3 * noise.standard_normal(X.shape), np.ones(2), 1.0)
    assert fit.shift(np.eye(1)) == pytest.approx([1.0], rel=0.1)
    assert fit.shift(np.eye(1)) >= 1.0


def test_a_number_that_differs_from_sixth_to_sixth_is_as_unsure_as_their_mean():
    """Of rows that are as good as independent, no block of neighbours shows that; heavy tails hide a third of it."""
    rng, key, own = np.random.default_rng(0), ("coulomb_friction", "elbow", "torque"), []
    sixths = 1.0 + np.array([0.1, -0.1, 0.05, 0.15, -0.1, -0.1])

    def missing(X):
        size = sixths[np.arange(len(X)) * 6 // len(X)]
        given = size[:, None] * X + 0.3 * rng.standard_normal(X.shape)
        own.extend(each.mean() for each in np.array_split((X * given)[:, 1], 6))
        return given

    fit = with_one_column(key, lambda shape: rng.choice([-1.0, 1.0], shape), missing, np.ones(2))
    assert np.sqrt(fit.covariance) == pytest.approx(np.std(own, ddof=1) / np.sqrt(6), rel=0.1)
    assert fit.freedom == 5


def test_a_constant_torque_is_none_beside_a_spring(weak):
    """The spring's own constant says it already."""
    effects, fit = fitted_plainly(weak[0], FILED, (*FOUR, "constant_torque"), others=True)
    assert {each.effect for each in of_others(effects, fit, SAME)} == {"armature"}
    assert {s.kind for s in fit.chosen.statements} == set(FOUR)


def test_a_links_probability_is_that_of_its_own_numbers():
    """The largest of several; and of all links', where its numbers are known with those of others alone."""
    effects, fit = fitted_plainly(recorded(3, friction, seconds=3.0), BODY, ("inertial_error",))
    numbers = of_links(effects, fit, BODY)
    upper = [replace(each, probability=0.9) for each in numbers if each.place == "upper"]
    fore = [replace(each, probability=n / 10) for n, each in enumerate(numbers) if each.place == "fore"]
    assert upper
    assert len(fore) > 1
    (each,) = stated(effects, fit, SAME, 1.0, (*upper, *fore))
    assert each.probability == {"upper": 0.9, "fore": max(e.probability for e in fore)}
    (each,) = stated(effects, fit, SAME, 1.0, upper)
    assert each.probability["fore"] == 0.9


def test_an_estimate_that_no_robot_can_have_is_its_least_value():
    """Rotors take no torque away: both are in the list, and one that would is none."""
    rows = recorded(2, lambda m: m.qdd * np.array([-0.02, 0.0]))
    effects, fit = fitted_plainly(rows, BODY, FOUR[:2], others=True)
    own = by_name(of_others(effects, fit, SAME))
    each = own["armature", "shoulder", "inertia"]
    assert each.value == 0.0
    assert each.probability < 0.5
    assert ("armature", "elbow", "inertia") in own
