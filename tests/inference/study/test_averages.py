"""Average curves against straight torques, whose values after the event are known."""

import numpy as np
import pytest
import torch

from invdyn.inference.study.averages import TIMES, average_curves
from invdyn.inference.study.pooling import pool
from invdyn.inference.study.trial import Trial
from invdyn.recordings import InputError

BEGIN, EVENT, END = np.array([[0.0, 1.0, 2.0], [5.0, 6.2, 7.4], [1.0, 1.5, 2.5], [0.0, 0.9, 2.0], [0.0, 0.7, 1.7]]).T
SLOPE, LEVEL, SD = np.array([[1.0, 0.2, 0.1], [1.4, -0.1, 0.3], [0.5, 0.6, 0.2], [2.0, 1.1, 0.1], [0.2, 0.9, 0.2]]).T
LOAD, WHO = list("xxxyy"), list("abbab")


def trial(k, **more):
    events, factors = {"touch": EVENT[k]}, {"load": LOAD[k]}
    return Trial(f"t{k}", None, None, WHO[k], **({"factors": factors, "events": events} | more))


def straight(k, joints=("elbow", "slide")):
    """Torque of the first joint, slope × time after the event + level; of the second, three times as much."""
    time = np.linspace(BEGIN[k], END[k], 9)
    mean = (SLOPE[k] * (time - EVENT[k]) + LEVEL[k])[:, None] * np.array([1.0, 3.0])[: len(joints)]
    numbers = {"time": time, "mean": mean, "spread": np.full_like(mean, SD[k])}
    said = {"joints": joints, "turns": [True, False][: len(joints)], "units": {"torque": "N·m"}}
    return {name: torch.as_tensor(values) for name, values in numbers.items()} | said


def test_each_time_is_pooled_over_the_trials_that_cover_it():
    trials, parts = [trial(k) for k in range(5)], {k: straight(k) for k in range(5)}
    found = average_curves(trials, parts, "touch", "load")
    assert len(found) == 2 * 2 * TIMES
    times = np.unique(found["time"])
    assert times[[0, -1]] == pytest.approx([-0.8, 1.0])  # ends of the usual trial of a level: of "x", and of "y"
    assert set(zip(found["joint"], found["unit"], strict=True)) == {("elbow", "N·m"), ("slide", "N")}
    for n in (0, TIMES // 2, TIMES - 1):
        own = [k for k in range(5) if BEGIN[k] - EVENT[k] <= times[n] <= END[k] - EVENT[k]]
        for joint, factor in (("elbow", 1.0), ("slide", 3.0)):
            y = factor * (SLOPE[own] * times[n] + LEVEL[own])
            labels = [[names[k] for k in own] for names in (LOAD, WHO, "11111")]
            exact = pool(y, SD[own], *labels)
            for level in "xy":
                rows = found[(found["joint"] == joint) & (found["load"] == level)]
                row = rows[rows["time"] == times[n]].iloc[0]
                assert row["trials"] == sum(LOAD[k] == level for k in own)
                assert row["mean"] == pytest.approx(exact.average(level).mean, rel=1e-6)
                assert row["q95"] == pytest.approx(exact.average(level).quantile(0.95), rel=1e-6)
                assert row["trial_q05"] == pytest.approx(exact.new_trial(level).quantile(0.05), rel=1e-6)
                assert row["trial_q95"] == pytest.approx(exact.new_trial(level).quantile(0.95), rel=1e-6)


def test_trials_without_the_event_the_factor_or_the_joint_are_not_there():
    more = [{}, {"events": {"touch": 7.5}}, {"events": {}}, {"factors": {}}, {}]
    trials = [trial(k, **own) for k, own in enumerate(more)]
    parts = {k: straight(k, ("elbow",) if k else ("elbow", "slide")) for k in range(5)}
    found = average_curves(trials, parts, "touch", "load")
    assert set(found["joint"]) == {"elbow"}  # one trial alone has the other
    assert set(found["trials"]) == {1}
    for k in (1, 2, 3):
        with pytest.raises(InputError, match="'touch' within them, got 1"):
            average_curves(trials, {each: parts[each] for each in (0, k)}, "touch", "load")
    parts[4] = straight(4, ("wrist",))
    with pytest.raises(InputError, match="expected a joint"):
        average_curves(trials, parts, "touch", "load")
