"""Onset and values at events of paths whose answers are plain."""

import arviz as az
import numpy as np
import pytest
import xarray as xr

from invdyn.inference.study.quantities import STATISTICS, at_times, onset, quantities, statistics

TIME = np.linspace(0.0, 1.0, 11)


def test_onset_is_the_last_row_under_a_tenth_of_the_peak():
    bump = np.array([0, 0.5, 0.19, 0.21, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0, 0.1])
    both = np.stack([bump, -bump], axis=-1)[None]
    assert onset(TIME, both) == pytest.approx(np.full((1, 2), 0.2))
    other_sign, first_row = (np.array([begin, 0.5, second, 0.5, *[2.0] * 7]) for begin, second in ((0, -1), (0.1, 0.5)))
    assert onset(TIME, np.stack([other_sign, first_row], axis=-1)[None]) == pytest.approx(np.array([[0.2, 0.0]]))


def test_a_trial_that_begins_under_load_has_no_onset():
    assert np.isnan(onset(TIME, np.linspace(1.0, 2.0, 11)[None, :, None])).all()


def test_values_at_events_are_linear_between_rows_and_missing_outside():
    path = np.stack([TIME, 3 * TIME], axis=-1)[None]
    found = at_times(TIME, path, np.array([0.0, 0.37, 1.0, 1.01, np.nan]))
    assert found[0, :3] == pytest.approx(np.array([[0.0, 0.0], [0.37, 1.11], [1.0, 3.0]]))
    assert np.isnan(found[0, 3:]).all()


def test_times_count_from_the_first_row():
    """Of a recording that begins 30 s late, and one that does not."""
    torque = np.zeros((1, 2, 11, 1)) + np.array([0, 0, 0.05, 0.3, 1, 2, 1, 0, 0, 0, 0.1])[:, None]
    dims = ["chain", "draw", "time", "joint"]
    for begin in (0.0, 30.0):
        data = {"torque": (dims, torque, {"units": "N·m"}), "velocity": (dims, torque)}
        coords = {"chain": [0], "draw": [0, 1], "time": begin + TIME, "joint": ["elbow"]}
        found = quantities(az.InferenceData(posterior=xr.Dataset(data, coords)), {"touch": begin + 0.35})
        assert found["peak_time"][0] == pytest.approx(np.full((2, 1), 0.5))
        assert found["onset"][0] == pytest.approx(np.full((2, 1), 0.2))
        assert found["at touch"][0] == pytest.approx(np.full((2, 1), 0.65))
        assert [found[name][1] for name in ("peak_time", "onset", "at touch")] == ["s", "s", "N·m"]


def drawn(peaks):
    peaks = np.asarray(peaks, float)[:, None]
    values = {"peak": (peaks, "N·m"), "peak_time": (peaks * 0 + 0.5, "s"), "impulse": (peaks, "N·m·s")}
    return values | {"peak_rate": (peaks, "N·m/s"), "onset": (peaks * 0 + 0.2, "s")}


def test_a_peak_of_either_sign_is_missing_and_the_impulse_is_not():
    numbers = statistics(drawn([2.0] * 74 + [-2.0] * 26))
    assert np.isnan(numbers[[0, 1, 3, 4]]).all()
    assert numbers[2, 0, STATISTICS.index("mean")] == pytest.approx(0.96)
    assert np.isfinite(statistics(drawn([2.0] * 75 + [-2.0] * 25))).all()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_peak_is_stated_of_the_draws_with_its_usual_sign(sign):
    numbers = statistics(drawn(sign * np.array([2.0] * 40 + [3.0] * 40 + [-2.0] * 20)))
    assert numbers[0, 0, STATISTICS.index("mean")] == pytest.approx(2.5 * sign)
    assert numbers[0, 0, STATISTICS.index("sd")] == pytest.approx(0.5)
    assert numbers[2, 0, STATISTICS.index("mean")] == pytest.approx(1.6 * sign)


def test_statistics_are_those_of_the_draws():
    values = np.random.default_rng(0).uniform(1.0, 2.0, 101)
    expected = [values.mean(), values.std(), *np.sort(values)[[5, 50, 95]]]
    assert statistics(drawn(values))[0, 0] == pytest.approx(expected)


def test_what_most_draws_lack_is_missing():
    for count in (49, 50):
        some = np.where(np.arange(100) < count, 1.0, np.nan)[:, None]
        values = {**drawn(np.ones(100)), "onset": (some, "s")}
        assert np.isnan(statistics(values)[-1]).all() == (count == 49)
    values["onset"] = (np.where(np.arange(100) < 60, np.arange(100.0), np.nan)[:, None], "s")
    assert statistics(values)[-1, 0, 0] == pytest.approx(29.5)
