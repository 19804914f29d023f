"""Long recordings in their most informative stretches."""

from itertools import pairwise

import numpy as np
from robot_log import ARM, robot_log

from invdyn.diagnosis.problem import stretches as module
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.stretches import left_out, looked_at, stretches
from invdyn.diagnosis.rules import DEFAULT
from invdyn.recordings import Recording


def resting_but(moves, seconds=400.0, rate=50):
    """A joint that rests at .3 rad but for some spans (begin, end), s, in which it swings."""
    time = np.arange(round(seconds * rate)) / rate
    angle = np.full(len(time), 0.3)
    for begin, end in moves:
        on = (time >= begin) & (time < end)
        angle[on] += 0.5 * np.sin(3 * (time[on] - begin)) ** 2
    angles = angle[:, None] + np.random.default_rng(0).normal(0, 1e-4, (len(time), 1))
    return Recording(time, np.zeros((len(time), 0, 2)), (), angles=angles, joint_names=("hip",), name="long log")


def seconds_of(parts):
    return sum(part.time[-1] - part.time[0] for part in parts)


def test_what_rows_show_well_is_one_stretch():
    log = resting_but([(0, 30)], seconds=30)
    assert stretches(log, DEFAULT.replace(max_rows=2000)) == [log]  # fewer rows
    assert stretches(log, DEFAULT.replace(max_rows=900)) == [log]  # 30 rows a second
    slow = resting_but([(0, 1000)], seconds=1900, rate=1)
    assert stretches(slow, DEFAULT.replace(max_rows=2000)) == [slow]


def test_where_the_arm_moves():
    parts = stretches(resting_but([(100, 120), (300, 310)]), DEFAULT.replace(max_rows=500))
    assert abs(seconds_of(parts) - 500 * DEFAULT.recording.max_row_spacing) < 1.5
    inside = sum(
        np.clip(min(part.time[-1], end) - max(part.time[0], begin), 0, None)
        for part in parts
        for begin, end in ((100, 120), (300, 310))
    )
    assert inside > 0.9 * seconds_of(parts)
    assert len(parts) < DEFAULT.recording.num_windows  # neighbours are one stretch
    assert all(one.time[-1] < other.time[0] for one, other in pairwise(parts))


def test_they_tell_more_than_any_evenly_spread_ones():
    log = robot_log(60, camera=False)
    edges = np.arange(0, 60.1, 0.4)
    information = module.information_in(log.time, log.angles, edges, DEFAULT.recording.max_row_spacing, DEFAULT)
    chosen = np.linalg.slogdet(information[module.most_informative(information, DEFAULT)].sum(0))[1]
    assert len(set(module.most_informative(information, DEFAULT))) == DEFAULT.recording.num_windows
    for first in range(7):
        assert chosen > np.linalg.slogdet(information[first::7][: DEFAULT.recording.num_windows].sum(0))[1]


def test_a_problem_of_them_says_what_was_left_out():
    rules = DEFAULT.replace(max_rows=200)
    log = robot_log(40, camera=False)
    problem = diagnosis_problem(log, ARM, rules=rules)
    assert 150 < len(problem.observations) <= 200
    parts = looked_at(log, rules)
    assert len(problem.starts) == len(parts) - 1 > 0
    told = left_out([log], rules)
    assert told.startswith(f"Of 20000 rows with an observation {len(problem.observations)} were used")
    assert f"of its 40 s the {seconds_of(parts):.4g} s with most information were used" in told
