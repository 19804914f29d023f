"""An arm's torques live: bands that hold them, the smoother's answer, gaps, commands, and a change of the body."""

import numpy as np
import pytest
import torch
from scipy.stats import norm

from invdyn.inference import LiveArm
from invdyn.inference.live import Z90
from invdyn.inputs import load_body
from invdyn.recordings import InputError
from invdyn.simulate import random_arm, record

FPS = 50
PLAIN = {"fps": FPS, "noise": 0.003}


@pytest.fixture(scope="module", name="body")
def a_body():
    return load_body("paper_planar_arm")


@pytest.fixture(scope="module", name="live")
def a_live_arm(body):
    return LiveArm(record(random_arm(body, duration=3, seed=1, **PLAIN), seed=1)[0], body, lag=0.1)


@pytest.fixture(scope="module", name="commanded")
def a_commanded_arm(body):
    return LiveArm(record(random_arm(body, duration=2, seed=1, commanded=True, **PLAIN), seed=1)[0], body)


def rows_of(live, recording):
    """Times and values of a recording's rows."""
    torques = np.zeros((recording.num_frames, 0)) if recording.torques is None else recording.torques
    both = np.concatenate([recording.keypoints.reshape(recording.num_frames, -1), torques], 1)
    names = [*live.columns, *live.commands]
    return [(time, dict(zip(names, row, strict=True))) for time, row in zip(recording.time, both, strict=True)]


def test_bands_hold_the_torques(live, body):
    recording, truth = record(random_arm(body, duration=4, seed=3, **PLAIN), seed=3)
    live.forget()
    answers = list(live.follow(rows_of(live, recording)))
    assert [each.time for each in answers] == pytest.approx(recording.time)
    mean, sd = (np.array([each.torque[k] for each in answers]) for k in (0, 1))
    off = np.abs(truth.torque - mean)
    assert 0.8 < (off < Z90 * sd).mean() < 0.97
    assert np.sqrt((off**2).mean(0)) == pytest.approx(np.sqrt((sd**2).mean(0)), rel=0.3)
    angle, velocity = (np.array([getattr(each, name)[0] for each in answers]) for name in ("angle", "velocity"))
    assert np.abs(angle - truth.angle).max() < 0.03
    inner = slice(5, -5)
    assert velocity[inner] == pytest.approx(np.gradient(truth.angle, 1 / FPS, axis=0)[inner], abs=1.0)
    line = live.table_row(answers[30])
    assert line["elbow_velocity"] == answers[30].velocity[0, 1]
    ends = [line[f"shoulder_torque_{end}"] for end in ("q05", "q95")]
    assert ends == pytest.approx(norm.ppf([0.05, 0.95], answers[30].torque[0, 0], answers[30].torque[1, 0]))


def test_rows_lost_late_and_doubled_are_counted(live, body):
    recording, truth = record(random_arm(body, duration=2, seed=4, **PLAIN), seed=4)
    rows = rows_of(live, recording)
    rows[30], rows[31] = rows[31], rows[30]
    rows = [*rows[:50], rows[49], *rows[53:], rows[10]]
    live.forget()
    answers = list(live.follow(rows))
    counts = live.smoother.counts
    assert (counts.rows, counts.lost, counts.late, counts.doubled, counts.restarts) == (100, 3, 1, 1, 0)
    mean, sd = (np.array([each.torque[k] for each in answers]) for k in (0, 1))
    assert (np.abs(truth.torque - mean) < Z90 * sd).mean() > 0.75
    assert sd[51, 0] > 1.1 * sd[40, 0]  # nothing was seen there


def test_jitter_of_a_clock_is_no_matter(live, body):
    """Times up to a third of a row off are rows of the grid."""
    recording, _ = record(random_arm(body, duration=1, seed=5, **PLAIN), seed=5)
    rows = rows_of(live, recording)
    off = np.random.default_rng(0).uniform(-0.3, 0.3, len(rows)) / FPS
    found = []
    for shift in (0 * off, off - off[0]):
        live.forget()
        found.append(list(live.follow((time + s, values) for (time, values), s in zip(rows, shift, strict=True))))
    assert live.smoother.counts.lost == 0
    for one, other in zip(*found, strict=True):
        assert one.torque == pytest.approx(other.torque, rel=1e-9)


def test_a_long_pause_starts_again(live, body):
    recording, truth = record(random_arm(body, duration=1, seed=6, **PLAIN), seed=6)
    rows = rows_of(live, recording)
    live.forget()
    answers = list(live.follow([*rows, *((time + 60, values) for time, values in rows)]))
    assert live.smoother.counts.restarts == 1
    assert live.smoother.counts.lost == 0
    again = [each for each in answers if each.time > 59]
    assert len(again) == len(rows)
    assert np.abs(np.array([each.angle[0] for each in again]) - truth.angle).max() < 0.03


def test_a_clock_that_begins_anew_starts_again(live, body):
    recording, truth = record(random_arm(body, duration=1, seed=6, **PLAIN), seed=6)
    rows = rows_of(live, recording)
    live.forget()
    answers = list(live.follow([*((time + 60, values) for time, values in rows), *rows]))
    assert (live.smoother.counts.restarts, live.smoother.counts.late) == (1, 0)
    again = [each for each in answers if each.time < 59]
    assert [each.time for each in again] == pytest.approx(recording.time)
    assert np.abs(np.array([each.angle[0] for each in again]) - truth.angle).max() < 0.03


def test_an_infinite_number_is_a_missing_one(live, body):
    recording, _ = record(random_arm(body, duration=1, seed=6, **PLAIN), seed=6)
    found = []
    for wrong in (np.nan, np.inf):
        rows = rows_of(live, recording)
        for n in (0, 20):
            rows[n] = (rows[n][0], dict.fromkeys(rows[n][1], wrong))
        live.forget()
        found.append(list(live.follow(rows)))
    assert live.smoother.counts.restarts == 0
    for one, other in zip(*found, strict=True):
        assert one.torque == pytest.approx(other.torque, rel=1e-9)


def test_a_late_row_has_its_own_command_and_none_else(commanded, body):
    recording, truth = record(random_arm(body, duration=2, seed=7, commanded=True, **PLAIN), seed=7)
    rows = rows_of(commanded, recording)
    for n in range(10, 90, 6):
        rows[n], rows[n + 1] = rows[n + 1], rows[n]
    commanded.forget()
    torque = np.array([each.torque[0] for each in commanded.follow(rows)])
    assert np.sqrt(((torque - truth.torque) ** 2).mean(0)) == pytest.approx([0.0, 0.0], abs=0.01)


def test_a_command_stands_until_the_next_one_in_time(commanded, body):
    """Row 20 comes late without a command, and row 22 has none: they have those of rows 19 and 21."""
    recording, _ = record(random_arm(body, duration=1, seed=7, commanded=True, **PLAIN), seed=7)
    found = []
    for sent in (False, True):
        rows = rows_of(commanded, recording)
        for n in (20, 22):
            before = {name: rows[n - 1][1][name] for name in commanded.commands}
            rest = {name: value for name, value in rows[n][1].items() if name in commanded.columns}
            rows[n] = (rows[n][0], rest | (before if sent else {}))
        if not sent:
            # another command, which comes late, does not stand
            rows[30] = (rows[30][0], {name: rows[30][1][name] for name in commanded.columns})
        else:
            rows[30] = (rows[30][0], rows[30][1] | {name: rows[29][1][name] for name in commanded.commands})
        rows[20], rows[21], rows[28], rows[29] = rows[21], rows[20], rows[29], rows[28]
        commanded.forget()
        found.append([each.torque for each in commanded.follow(rows)])
    assert np.array(found[0]) == pytest.approx(np.array(found[1]), rel=1e-9)


def test_rows_without_the_calibrations_commands_are_refused(commanded):
    commanded.forget()
    with pytest.raises(InputError, match="shoulder_torque, elbow_torque from the first row on"):
        commanded.add(0.0, {"elbow_x": 0.0})


def test_known_commands_are_part_of_the_torque(commanded, body):
    recording, truth = record(random_arm(body, duration=2, seed=7, commanded=True, **PLAIN), seed=7)
    commanded.forget()
    answers = list(commanded.follow(rows_of(commanded, recording)))
    torque = np.array([each.torque[0] for each in answers])
    assert np.sqrt(((torque - truth.torque) ** 2).mean(0)) == pytest.approx([0.0, 0.0], abs=0.1)
    assert not any(each.changed for each in answers)


def test_a_load_is_told_within_two_seconds(commanded, body):
    """The forearm is half as heavy again from 2 s on; before, there is no alarm."""
    model = random_arm(body, duration=4, seed=8, commanded=True, **PLAIN)
    torch.manual_seed(8)
    states, observed = model.simulate()
    _, angle, velocity = model.split(states[99])
    still = torch.full_like(angle, 1e-9)
    rest = model.at_times(model.time[99:] - model.time[99]).commanded(model.command[99:])
    heavier = {k: model.parameters[k] * torch.tensor([1.0, 1.5]) for k in ("body.mass", "body.inertia")}
    begin = {"angle": angle, "velocity": velocity, "angle_scale": still, "velocity_scale": still}
    _, after = rest.replace(**{f"initial.{k}": v for k, v in begin.items()}, **heavier).simulate()
    both = torch.cat([observed[:100], after[1:]]).numpy()
    names = [*commanded.columns, *commanded.commands]
    commanded.forget()
    told = [
        each.time
        for t in range(len(both))
        for each in commanded.add(t / FPS, dict(zip(names, [*both[t], *model.command[t].tolist()], strict=True)))
        if each.changed
    ]
    assert 2.0 <= told[0] <= 4.0
    assert told[1] - told[0] > 1.5 / FPS  # after an alarm it begins again


def test_what_cannot_be_is_refused(live, body):
    recording, _ = record(random_arm(body, duration=1, seed=6, **PLAIN), seed=6)
    with pytest.raises(InputError, match="lag from 0 to 5 s"):
        LiveArm(recording, body, lag=-1.0)
    with pytest.raises(InputError, match="lag from 0 to 5 s"):
        LiveArm(recording, body, lag=float("nan"))
    with pytest.raises(InputError, match="time of a row"):
        live.add(float("nan"), {"elbow_x": 0.0})
    with pytest.raises(InputError, match="time of a row"):
        live.add(1e300, {"elbow_x": 0.0})
    with pytest.raises(InputError, match="columns among elbow_x"):
        live.add(0.0, {"hand_x": 0.0})
